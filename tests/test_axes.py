"""Axes of configurations: one declaration reads, writes, bounds and documents each."""

from typing import Any

import numpy as np
import pandas as pd
import pytest
from flax import struct
from hypothesis import given, settings, strategies
from hypothesis.extra.numpy import arrays

import pecjax
from pecjax.envs.axes import axes_of, axis, columns_of, from_columns, make_table, required, to_columns
from pecjax.envs.configuration_files import read_table, table_text


@struct.dataclass
class Windy:
    start: Any = axis("start_x start_y", unit="m", low=-100, high=100)
    map_id: Any = axis("map", dtype=np.int32, default=0, low=0)
    wind: Any = axis("wind_x wind_y", default=0.0, unit="m/s", low=-20, high=20)
    payload: Any = axis("payload", default=0.5, unit="kg", low=0)


START = np.float32([(0, -2), (1, 2.5), (-3, 4)])


def write(tmp_path, text):
    path = tmp_path / "table.csv"
    path.write_text(text)
    return path


def assert_tables_equal(one, other):
    for name in axes_of(Windy):
        found, wanted = getattr(one, name), getattr(other, name)
        assert found.dtype == wanted.dtype and found.shape == wanted.shape
        np.testing.assert_array_equal(found, wanted)


def test_missing_axes_have_their_defaults_and_their_types():
    table = make_table(Windy, start=START)
    assert table.start.dtype == np.float32 and table.map_id.dtype == np.int32
    np.testing.assert_array_equal(table.map_id, [0, 0, 0])
    np.testing.assert_array_equal(table.wind, np.zeros((3, 2)))
    np.testing.assert_array_equal(table.payload, np.float32([0.5] * 3))
    assert required(Windy) == ["start_x", "start_y"]
    assert list(columns_of(Windy)) == ["start_x", "start_y", "map", "wind_x", "wind_y", "payload"]


@pytest.mark.parametrize("names", [[], ["map"], ["wind_x", "wind_y"], ["payload", "map"]])
@pytest.mark.parametrize("mark", ["", "# "])
def test_a_file_has_any_subset_of_the_columns_in_any_order(names, mark, tmp_path):
    values = {
        "start_x": START[:, 0],
        "start_y": START[:, 1],
        "map": [2, 0, 1],
        "wind_x": [1.5, 0, -20],
        "wind_y": [0, 0.25, 20],
        "payload": [0, 1, 2],
    }
    frame = pd.DataFrame(values)[[*names, "start_y", "start_x"]]
    header = ",".join(frame.columns)
    text = frame.to_csv(index=False, header=False)
    found = read_table(write(tmp_path, f"{mark}{header}\n{text}"), Windy)
    assert_tables_equal(found, from_columns(Windy, dict(frame)))
    for name in names:
        np.testing.assert_array_equal(to_columns(found)[name], np.float32(values[name]))


def test_without_a_header_a_line_has_the_required_columns(tmp_path):
    found = read_table(write(tmp_path, "0 -2\n1, 2.5 # here\n\n-3,4\n"), Windy)
    assert_tables_equal(found, make_table(Windy, start=START))


numbers = strategies.integers(1, 30).flatmap(
    lambda rows: strategies.tuples(
        arrays(np.float32, (rows, 2), elements=strategies.floats(-100, 100, width=32)),
        arrays(np.int32, rows, elements=strategies.integers(0, 2**31 - 1)),
        arrays(np.float32, (rows, 2), elements=strategies.floats(-20, 20, width=32)),
        arrays(np.float32, rows, elements=strategies.floats(0, 2.0**100, width=32)),
    )
)


@settings(deadline=None, derandomize=True, max_examples=100)
@given(numbers)
def test_any_table_reads_back_from_its_file_as_it_was(tmp_path_factory, leaves):
    path = tmp_path_factory.mktemp("tables") / "table.csv"
    table = make_table(Windy, **dict(zip(axes_of(Windy), leaves, strict=True)))
    path.write_text(table_text(table))
    assert_tables_equal(read_table(path, Windy), table)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("start_x,start_y,wnd_x\n0,0,1\n", "line 1, column 3: 'wnd_x' is unknown (did you mean wind_x?)"),
        ("start_x,start_y,map,map\n0,0,1,1\n", "line 1, column 4: 'map' stands twice"),
        ("start_x,wind_x,wind_y\n0,0,0\n", "line 1: no column start_y; the columns are start_x"),
        ("start_x,start_y,wind_x\n0,0,0\n", "line 1: no column wind_y"),  # half an axis
        (
            "start_x,start_y,wind_x,wind_y\n\n0,0,1,1\n0,0,1,-21\n",
            "line 4, column 4: wind_y is -21; it must be a number from -20 to 20 m/s",
        ),
        ("start_x,start_y,payload\n0,0,-1\n", "column 3: payload is -1; it must be a number from 0 kg"),
        ("start_x,start_y,payload\n0,0,inf\n", "column 3: payload is inf; it must be a number from 0 kg"),
        ("start_x,start_y,map\n0,0,1.5\n", "column 3: map is 1.5; it must be a whole number from 0"),
        ("start_x,start_y,map\n0,0\n", "line 2: '0,0' is not 3 numbers; write start_x, start_y, map"),
        ("start_x,start_y,map\n0,0,1,1\n", "line 2: '0,0,1,1' is not 3 numbers"),
        ("0,nan\n", "line 1, column 2: start_y is nan"),
        ("start_x,start_y,map\n", "no configurations; write one 'start_x, start_y, map' a line"),
    ],
)
def test_files_that_are_wrong_are_refused_in_one_line(text, words, tmp_path):
    path = write(tmp_path, text)
    with pytest.raises(pecjax.InputError) as caught:
        read_table(path, Windy)
    assert words in str(caught.value) and str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"start": START, "wnd": 1}, r"no axis wnd \(did you mean wind\?\); there are start, map_id"),
        ({"wind": START}, "no column start_x"),
        ({"start": START, "wind": np.zeros(3)}, r"wind has shape \(3,\); give an array \(N, 2\)"),
        ({"start": START, "payload": 1.0}, r"payload has shape \(\); give an array \(N,\)"),
        ({"start": START, "payload": np.ones(2)}, r"have \[2, 3\] rows"),
        (
            {"start": START, "wind": START * np.float32([1, 9])},
            "configuration 1: wind_y is 22.5; .* from -20 to 20 m/s",
        ),
    ],
)
def test_tables_that_are_wrong_are_refused(values, words):
    with pytest.raises(pecjax.InputError, match=words):
        make_table(Windy, **values)


def test_a_comment_that_speaks_of_a_column_is_no_header(tmp_path):
    text = "# start_x is where the drone begins\n# start_x start_y\n0,-2\n1,2.5\n-3,4\n"
    assert_tables_equal(read_table(write(tmp_path, text), Windy), make_table(Windy, start=START))
