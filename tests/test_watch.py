"""The page of `pecjax watch`, in a real browser where there is one."""

import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pecjax.envs.rooms.maps import MapBank
from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.rooms.task import SPEEDS, YAW_RATES
from pecjax.envs.task import take_configs
from pecjax.errors import InputError
from pecjax.training.run_arrays import ENDINGS
from pecjax.viewing.history import History
from pecjax.viewing.page import page
from pecjax.viewing.recording import make_recording

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
FLIGHTS, STEPS = 50, 120


@pytest.fixture(scope="module")
def rooms():
    return Rooms().make()


def arrays_of(world, flights=FLIGHTS, steps=STEPS):
    """Flights that go straight from start to goal, ever more tilted; every third one ends early."""
    config_id = np.arange(flights) % 20
    ways = np.stack([world.table.start[config_id], world.table.goal[config_id]], axis=1)
    along = np.linspace(0, 1, steps + 1)[:, None]
    places = ways[:, :1] + along * (ways[:, 1:] - ways[:, :1])
    turns = Rotation.from_euler("ZYX", np.linspace([0, 0, 0], [3, 0.4, -0.3], steps + 1))
    quaternions = np.broadcast_to(turns.as_quat(scalar_first=True), (flights, steps + 1, 4))
    heights = np.full((flights, steps + 1, 1), 1.2)
    kind = np.arange(flights) % 3
    return {
        "config_id": config_id,
        "length": np.where(kind == 1, steps // 2, steps),
        "success": kind == 0,
        "collision": (kind == 1).astype(float),
        "timeout": (kind == 2).astype(float),
        "recorded": np.arange(flights),
        "poses": np.concatenate([places, heights, quaternions], axis=2).astype(np.float32),
        "actions": np.tile(np.arange(steps) % 15, (flights, 1)),
    }


@pytest.fixture(scope="module")
def recording(rooms):
    return make_recording("A test <run>", *rooms, arrays_of(rooms[1]), most=FLIGHTS)


def history_of(world):
    relative = np.linspace(0.2, 5, 60).reshape(3, 20)
    table = world.table
    return History(np.array([1, 20, 40]), relative, table.start, table.goal, np.asarray(table.map_id), 20)


def test_a_recording_is_what_was_flown(rooms, recording):
    task, world = rooms
    arrays = arrays_of(world)
    assert [flight.ending for flight in recording.flights[:3]] == list(ENDINGS[:3])
    early = recording.flights[1]
    assert early.poses.shape == (STEPS // 2 + 1, 7)
    np.testing.assert_array_equal(early.poses, arrays["poses"][1, : STEPS // 2 + 1])
    asked = [(SPEEDS[action // 5], YAW_RATES[action % 5]) for action in range(15)]
    np.testing.assert_allclose(recording.flights[0].commands[:15], asked, rtol=1e-6)
    state = task.place(take_configs(world.table, early.config_id), 0.0)
    seen = task.sense(jax.random.key(0), state._replace(qpos=jnp.asarray(early.poses[7])), world.params)
    # Metres, of one image computed alone.
    np.testing.assert_allclose(early.depth[7], seen["depth"], atol=1e-4)


def test_of_many_flights_some_are_shown_spread_evenly(rooms):
    few = make_recording("", *rooms, arrays_of(rooms[1], steps=10), most=4)
    assert [flight.config_id for flight in few.flights] == [0, 16, 12, 9]


def test_a_waypoint_is_shown_where_the_objective_leads_to_it(rooms):
    task, world = rooms
    objective = np.arange(20, dtype=np.int32) % 3
    table = world.table.replace(objective=objective, waypoint=np.zeros((20, 2), np.float32))
    found = make_recording("", task, world._replace(table=table), arrays_of(world, steps=10), most=FLIGHTS)
    passes = [flight.waypoint is not None for flight in found.flights]
    assert passes == [objective[flight.config_id] == 2 for flight in found.flights] and any(passes)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("poses", np.zeros((FLIGHTS, STEPS // 4, 7))),
        ("poses", np.zeros((FLIGHTS, STEPS + 1, 3))),
        ("actions", np.zeros((FLIGHTS, 3), int)),
        ("length", np.zeros(FLIGHTS, int)),
        ("recorded", np.zeros(0, int)),
    ],
)
def test_arrays_that_do_not_fit_are_told(name, value, rooms):
    with pytest.raises(ValueError, match=r"no .*poses|no flights"):
        make_recording("", *rooms, arrays_of(rooms[1]) | {name: value}, most=FLIGHTS)


def test_other_tasks_cannot_be_watched(rooms):
    with pytest.raises(InputError, match="only flights through rooms"):
        make_recording("", object(), rooms[1], {}, 1)


def test_the_page_is_small_and_whole(rooms, recording):
    text = page(recording, history_of(rooms[1]))
    assert len(text) < 5e6
    assert "{{" not in text.split("<script")[0]
    assert "A test &lt;run&gt;" in text


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api")
    if BROWSER is None:
        pytest.skip("no Chromium here, which no package of Python brings along; .ci/run installs it")
    software = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=BROWSER, args=software)
        yield opened
        opened.close()


@pytest.fixture
def opened(browser, tmp_path):
    """Opens a page's text, and sees to it that it neither complains nor loads anything."""
    said, loaded = [], []

    def open_page(text, address="#time=0", size=(1100, 700)):
        path = tmp_path / "page.html"
        path.write_text(text)
        tab = browser.new_page(viewport=dict(zip(("width", "height"), size, strict=True)))
        tab.on("console", lambda message: said.append(message.text))
        tab.on("pageerror", lambda error: said.append(str(error)))
        tab.on("request", lambda request: loaded.append(request.url))
        tab.goto(path.as_uri() + address)
        tab.wait_for_function("document.body.dataset.ready === 'true'", timeout=120_000)
        settle(tab)
        return tab

    yield open_page
    assert not said
    assert [url.partition("#")[0] for url in loaded] == [(tmp_path / "page.html").as_uri()]


def settle(tab):
    """Waits for the frame in which all that was asked for is drawn."""
    tab.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def test_the_page_shows_what_was_recorded(rooms, recording, opened):
    tab = opened(page(recording, history_of(rooms[1])))
    shown = tab.evaluate(
        "() => player.data.flights.map(({config, ending, length, positions, speed, roll, pitch, distance}) =>"
        " ({config, ending, length, speed: [...speed], roll: [...roll], pitch: [...pitch],"
        "   distance: [...distance], positions: [...positions]}))"
    )
    assert len(shown) == FLIGHTS
    for flight, there in list(zip(recording.flights, shown, strict=True))[:4]:
        assert (there["config"], there["ending"]) == (flight.config_id, flight.ending)
        np.testing.assert_array_equal(np.reshape(there["positions"], (-1, 7)), flight.poses)
        flown = np.linalg.norm(np.diff(flight.poses[:, :2], axis=0), axis=1) / 0.1
        np.testing.assert_allclose(there["speed"], flown, rtol=1e-3, atol=1e-4)
        angles = Rotation.from_quat(flight.poses[:, 3:], scalar_first=True).as_euler("ZYX", degrees=True)
        np.testing.assert_allclose(there["pitch"], angles[:, 1], atol=1e-3)
        np.testing.assert_allclose(there["roll"], angles[:, 2], atol=1e-3)
        away = np.linalg.norm(flight.goal - flight.poses[:, :2], axis=1)
        np.testing.assert_allclose(there["distance"], away, atol=1e-4)


def test_the_slider_moves_the_drone(recording, opened):
    tab = opened(page(recording))
    drone = "() => player.world.flights[player.chosen].drone.position.toArray()"
    before, picture = tab.evaluate(drone), tab.locator("#world").screenshot()
    tab.locator("#time").evaluate(
        "(slider) => { slider.value = 60; slider.dispatchEvent(new Event('input')); }"
    )
    settle(tab)
    chosen = recording.flights[tab.evaluate("() => player.chosen")]
    np.testing.assert_allclose(tab.evaluate(drone), chosen.poses[60, :3], atol=1e-5)
    assert before != tab.evaluate(drone)
    assert picture != tab.locator("#world").screenshot()
    assert tab.locator("#clock").inner_text() == "6.0 / 12.0 s"


def test_flights_are_picked_by_ending_and_configuration(recording, opened):
    tab = opened(page(recording))
    tab.select_option("#ending", "collision")
    collisions = [f"c{flight.config_id}" for flight in recording.flights if flight.ending == "collision"]
    assert tab.locator("#flights span:nth-child(2)").all_inner_texts() == collisions
    tab.select_option("#config", "4")
    assert tab.locator("#flights > div").count() == collisions.count("c4")
    tab.select_option("#ending", "")
    rows = tab.locator("#flights > div")
    rows.nth(1).click()
    assert rows.nth(1).get_attribute("aria-selected") == "true"
    visible = "() => player.world.flights.filter((view) => view.group.visible).length"
    assert tab.evaluate(visible) == sum(flight.config_id == 4 for flight in recording.flights)


def test_cameras_differ_and_it_plays(recording, opened):
    tab = opened(page(recording))
    pictures = set()
    for camera in ("free", "chase", "top"):
        tab.locator(f"[data-camera={camera}]").click()
        settle(tab)
        pictures.add(tab.locator("#world").screenshot())
    assert len(pictures) == 3
    tab.locator("#play").click()
    tab.wait_for_function("player.steps > 0")
    tab.locator("#play").click()
    assert not tab.evaluate("() => player.playing")


def test_the_history_colours_the_map(rooms, recording, opened):
    tab = opened(page(recording, history_of(rooms[1])))
    before = tab.locator("#world").screenshot()
    tab.locator("#show-history").check()
    settle(tab)
    last = tab.locator("#world").screenshot()
    tab.locator("#iteration").evaluate(
        "(slider) => { slider.value = 0; slider.dispatchEvent(new Event('input')); }"
    )
    settle(tab)
    assert len({before, last, tab.locator("#world").screenshot()}) == 3
    assert "After iteration 1:" in tab.locator("#history-caption").inner_text()
    scale = [tab.evaluate("(relative) => colorOf(relative)", ratio) for ratio in (0.01, 1 / 8, 8, 100)]
    assert scale[0] == scale[1] == "rgb(68,1,84)"  # both ends of viridis
    assert scale[2] == scale[3] == "rgb(253,231,37)"


def test_a_map_of_64_boxes(rooms, opened):
    task, world = rooms
    low = np.random.default_rng(0).uniform(-9, 7, (1, 64, 3)).astype(np.float32) * [1, 1, 0]
    bank = MapBank(low, low + np.array([0.4, 0.4, 2]), np.array([[[-10, -10], [8, 8]]]))
    params = world.params._replace(bank=bank)
    flown = make_recording("64 boxes", task, world._replace(params=params), arrays_of(world, 3, 20), 3)
    tab = opened(page(flown), size=(390, 800))
    assert tab.evaluate("() => player.data.maps[0].walls.length") == 64
    picture = tab.locator("#world").screenshot()
    tab.evaluate("() => player.setTime(10)")
    settle(tab)
    assert picture != tab.locator("#world").screenshot()
    assert tab.evaluate("() => document.documentElement.scrollWidth") <= 390
