"""New maps: a few rooms to begin a map of one's own with, as MJCF and as a text plan."""

from __future__ import annotations

import re

from pecjax.envs.rooms.default_drone import default_scene_path

# The drone, its actuators and the defaults come from the six rooms.
_MJCF = """\
<mujoco model="my rooms">
  <!-- Three rooms and a drone, to be changed. Lengths in metres; seen from above, x grows to the right and
       y upwards. `pecjax check` draws what it understands of this file.

       A box has its middle at pos, and size is half its length, width and height. The drone hits and sees
       every geom unless it has contype="0" conaffinity="0". -->
{options}
{depth_range}
{defaults}
  <worldbody>
    <light pos="5 4 12" dir="0 0 -1" directional="true"/>
    <geom name="floor" type="plane" size="0 0 1" rgba="0.5 0.48 0.45 1"/>

    <!-- The outer walls. Leave no gap, or the drone flies away. -->
    <geom class="wall" name="west" pos="0 4 1.25" size="0.1 4.1 1.25"/>
    <geom class="wall" name="east" pos="10 4 1.25" size="0.1 4.1 1.25"/>
    <geom class="wall" name="south" pos="5 0 1.25" size="5.1 0.1 1.25"/>
    <geom class="wall" name="north" pos="5 8 1.25" size="5.1 0.1 1.25"/>

    <!-- x = 5, with a door from y = 1.2 to 2.6. The drone is 0.5 m wide. -->
    <geom class="wall" name="middle_a" pos="5 0.6 1.25" size="0.1 0.6 1.25"/>
    <geom class="wall" name="middle_b" pos="5 5.3 1.25" size="0.1 2.7 1.25"/>

    <!-- y = 4, with a door from x = 7.6 to 9. -->
    <geom class="wall" name="divider_a" pos="6.3 4 1.25" size="1.3 0.1 1.25"/>
    <geom class="wall" name="divider_b" pos="9.5 4 1.25" size="0.5 0.1 1.25"/>

    <!-- A pillar, and a table: the drone flies over it, at 1.2 m. -->
    <geom class="wall" name="pillar" pos="2.5 4 1.25" size="0.3 0.3 1.25"/>
    <geom class="wall" name="table" pos="7.5 2 0.4" size="0.6 0.4 0.4"/>

    <!-- It flies from every site that is named start… to every one that is named goal…, unless it is given
         other places with the option coordinates. -->
    <site name="start_south" pos="1.2 1.2 0" size="0.1"/>
    <site name="start_north" pos="1.2 6.8 0" size="0.1"/>
    <site name="goal_south" pos="9 1 0" size="0.1"/>
    <site name="goal_north" pos="9 7 0" size="0.1"/>

{drone}  </worldbody>

{actuators}</mujoco>
"""

_TEXT = """\
// Three rooms, to be changed: # is wall, . is free.
// The drone flies from every S to every G, unless it is given other places with --coordinates.
// A character is a square of so many metres, and walls are so high:
cell 1
height 2.5

################
#......#.......#
#......#.....G.#
#.S....#.......#
#......#.......#
#...#..#####..##
#..............#
#..............#
#.S....#.....G.#
#......#.......#
################
"""


def new_mjcf() -> str:
    """Three rooms with the drone of the six rooms."""
    rooms = default_scene_path().read_text("utf-8")

    def part(pattern: str) -> str:
        found = re.search(rf"(?ms)^  {pattern}\n", rooms)
        assert found, pattern
        return found[0]

    drone = part(r"  <!-- Mass and inertia.*?^    </body>")
    return _MJCF.format(
        options=part(r"<compiler.*?^  </option>"),
        depth_range=part(r"<custom>.*?^  </custom>"),
        defaults=part(r"<default>.*?^  </default>"),
        drone=re.sub(r'(<body name="drone" pos=)"[^"]*"', r'\1"1.2 1.2 1.2"', drone),
        actuators=part(r"<actuator>.*?^  </actuator>"),
    )


def new_text_plan() -> str:
    """Three rooms drawn with characters."""
    return _TEXT
