"""Geodesics: the shortest paths of the drone's sphere at its flight height, looked for on a grid.

A path goes from cell to cell in 16 directions, which makes it at most 1 / cos(½ arctan ½) = 1.028 times
as long as the shortest one, and a little more beside the corners that it rounds a cell too far. Where
the goal can be reached straight ahead its length is exact. A cell is free where the clearance is above
√(radius² + (cell / 2)²): then each move between free cells can be flown.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pecjax.envs.rooms.clearance_grid import ClearanceGrid, clearance_along, make_grid

if TYPE_CHECKING:
    from scipy.sparse import csr_array  # which takes long to import, and most trainings need no paths

CELL = 0.1  # m, of the grid by default
_AT_ONCE = 16  # flights for which the distances of all cells are held

_STRAIGHT = [(1, 0), (0, 1), (-1, 0), (0, -1)]
_DIAGONAL = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
_LONG, _WIDE = ([(x, y) for x in a for y in b] for a, b in (((2, -2), (1, -1)), ((1, -1), (2, -2))))
_MOVES = np.array(_STRAIGHT + _DIAGONAL + _LONG + _WIDE)
# The cells that a move passes between must be free as well; a straight one passes none.
_PASSED = np.array(
    [[(0, 0), (0, 0)] for _ in _STRAIGHT]
    + [[(x, 0), (0, y)] for x, y in _DIAGONAL]
    + [[(x // 2, 0), (x // 2, y)] for x, y in _LONG]
    + [[(0, y // 2), (x, y // 2)] for x, y in _WIDE]
)
# Where a path may leave the grid for a place beside it, in cells from the nearest one.
_LINKS = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], indexing="ij"), axis=-1).reshape(9, 2)
_HERE = 4  # the nearest one itself
_SAME = 1e-5  # m, within which a place is a node; float32 has no finer ones in large maps


class Paths(NamedTuple):
    """The graph of all moves in one map.

    Attributes:
        grid: the clearance that it was made from.
        radius: m, of the sphere that flies.
        number: (X, Y) int32, the node of each free cell, -1 of the others.
        places: (K, 2) m, where the nodes are.
        moves: (K, K), lengths in m.
    """

    grid: ClearanceGrid
    radius: float
    number: np.ndarray
    places: np.ndarray
    moves: csr_array


class Way(NamedTuple):
    """A shortest path.

    Attributes:
        length: m; infinite where there is no path.
        points: (P, 2) m from start to goal; without any where there is no path.
    """

    length: float
    points: np.ndarray


def free_clearance(radius: float, cell: float) -> float:
    """The clearance (m) above which a cell is free."""
    return float(np.hypot(radius, cell / 2))


def find_paths(grid: ClearanceGrid, radius: float) -> Paths:
    """The graph of the moves that a sphere of this radius (m) can make; the grid must reach beyond it."""
    from scipy.sparse import csr_array

    free = np.pad(grid.clearance > free_clearance(radius, grid.cell), 2)  # no move leaves the padded grid
    flat, row = free.ravel(), free.shape[1]
    steps, passed = _MOVES @ [row, 1], _PASSED @ [row, 1]
    # Of the flat grid without the padding's ends, slices that are moved by a step hold where it leads.
    inner = slice(2 * row + 2, len(flat) - 2 * row - 2)
    moved = {step: flat[inner.start + step : inner.stop + step] for step in {0, *steps, *passed.flat}}
    can = np.stack([
        moved[0] & moved[step] & moved[one] & moved[other]
        for step, (one, other) in zip(steps, passed, strict=True)
    ])  # fmt: skip
    cells = np.flatnonzero(moved[0]).astype(np.int32) + np.int32(inner.start)
    possible = can.T[moved[0]]
    number = np.cumsum(flat, dtype=np.int32) - 1
    ends = number[(cells[:, None] + steps.astype(np.int32))[possible]]
    starts_at = np.concatenate([[0], np.cumsum(possible.sum(axis=1, dtype=np.int32))]).astype(np.int32)
    lengths = np.broadcast_to(grid.cell * np.linalg.norm(_MOVES, axis=1), possible.shape)[possible]
    moves = csr_array((lengths, ends, starts_at), shape=(len(cells),) * 2)
    places = grid.origin + grid.cell * (np.stack(np.divmod(cells, row), axis=-1) - 2)
    numbered = np.where(free, number.reshape(free.shape), -1)[2:-2, 2:-2]
    return Paths(grid, radius, numbered, places, moves)


def search(paths: Paths, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances to all nodes from places (N, 2) m, which need not be nodes.

    Returns:
        (N, K) m, infinite where no path leads, and (N, K) the node that each is reached from, -1
        where it is the start.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    nodes, lengths = _links(paths, starts)
    known = np.isfinite(lengths)
    size, extra = len(paths.places), len(starts)
    if np.all(lengths.min(axis=1) == 0):  # all are nodes
        sources, graph = nodes[np.arange(extra), lengths.argmin(axis=1)], paths.moves
    else:
        # The starts are further nodes that can only be left. A length of 0 would be no edge.
        sources = size + np.arange(extra)
        further = np.cumsum(known.sum(axis=1)) + paths.moves.indptr[-1]
        edges = (
            np.concatenate([paths.moves.data, np.maximum(lengths[known], 1e-9)]),
            np.concatenate([paths.moves.indices, nodes[known]]),
            np.concatenate([paths.moves.indptr, further]),
        )
        graph = csr_array(edges, shape=(size + extra,) * 2)
    distances, before = dijkstra(graph, indices=sources, return_predecessors=True)
    before = np.where(before >= size, -1, before)
    return distances[:, :size], before[:, :size]


def shortest_ways(paths: Paths, starts: np.ndarray, goals: np.ndarray) -> list[Way]:
    """The shortest path for each pair of places, (N, 2) m each, which must be clear of walls."""
    starts, goals = (np.asarray(points, np.float64).reshape(-1, 2) for points in (starts, goals))
    ways = []
    for first in range(0, len(starts), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        ways.extend(_ways(paths, starts[some], goals[some]))
    return ways


def _ways(paths: Paths, starts: np.ndarray, goals: np.ndarray) -> list[Way]:
    ways = [straight_way(paths, start, goal) for start, goal in zip(starts, goals, strict=True)]
    rest = [pair for pair, way in enumerate(ways) if way is None]
    if rest:
        distances, before = search(paths, starts[rest])
        for row, pair in enumerate(rest):
            ways[pair] = way_on_grid(paths, starts[pair], goals[pair], distances[row], before[row])
    return [way for way in ways if way is not None]


def straight_way(paths: Paths, start: np.ndarray, goal: np.ndarray) -> Way | None:
    """The straight flight between two places (2,) m, if nothing stands in its way."""
    points = np.stack([start, goal])
    if clearance_along(paths.grid, points[:1], points[1:])[0] <= paths.radius:
        return None
    return Way(float(np.linalg.norm(points[1] - points[0])), points)


def way_on_grid(
    paths: Paths, start: np.ndarray, goal: np.ndarray, distances: np.ndarray, before: np.ndarray
) -> Way:
    """The shortest path from cell to cell, from what `search` found from its start, (K,) each."""
    (nodes,), (lengths,) = _links(paths, goal[None])
    totals = lengths
    totals[nodes >= 0] += distances[nodes[nodes >= 0]]
    last = int(np.argmin(totals))
    if not np.isfinite(totals[last]):
        return Way(np.inf, np.zeros((0, 2)))
    order, node = [], int(nodes[last])
    while node >= 0:
        order.append(node)
        node = int(before[node])
    return Way(float(totals[last]), np.concatenate([start[None], paths.places[order[::-1]], goal[None]]))


def _links(paths: Paths, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nodes (N, 9) around each place, -1 for none, and how far (m) they are if nothing is between."""
    grid = paths.grid
    cells = np.round((points - grid.origin) / grid.cell).astype(int)[:, None] + _LINKS
    inside = np.all((cells >= 0) & (cells < paths.number.shape), axis=-1)
    cells = np.where(inside[..., None], cells, 0)
    nodes = np.where(inside, paths.number[cells[..., 0], cells[..., 1]], -1)
    lengths = np.full(nodes.shape, np.inf)
    at_node = nodes[:, _HERE] >= 0
    at_node[at_node] = np.linalg.norm(paths.places[nodes[at_node, _HERE]] - points[at_node], axis=1) < _SAME
    lengths[at_node, _HERE] = 0
    rows, columns = np.nonzero((nodes >= 0) & ~at_node[:, None])
    if rows.size:
        away = paths.places[nodes[rows, columns]]
        clear = clearance_along(grid, points[rows], away) > paths.radius
        lengths[rows, columns] = np.where(clear, np.linalg.norm(away - points[rows], axis=-1), np.inf)
    return nodes, lengths


def geodesic_lengths(
    lower: np.ndarray,
    upper: np.ndarray,
    bounds: np.ndarray,
    starts: np.ndarray,
    goals: np.ndarray,
    *,
    radius: float,
    flight_height: float,
    cell: float = CELL,
) -> np.ndarray:
    """Lengths (N,) m of the shortest paths between places of one map; infinite where there is none.

    Args:
        lower, upper: (W, 3) m, the walls' corners, and `bounds` (2, 2) m of the map, as `map_file.Map`
            has them.
        starts, goals: (N, 2) m.
        radius, flight_height: m, of the drone.
        cell: m, of the grid; the larger, the quicker and the further around corners.

    Raises:
        InputError: the map has too many cells.
    """
    grid = make_grid(
        lower,
        upper,
        bounds,
        flight_height=flight_height,
        cell=cell,
        reach=free_clearance(radius, cell) + cell,
    )
    ways = shortest_ways(find_paths(grid, radius), starts, goals)
    return np.array([way.length for way in ways])
