"""Sum tree: numbers drawn in proportion to their priorities, in logarithmic time."""

from __future__ import annotations

import jax
import jax.numpy as jnp

# A tree over C leaves, C a power of two, is one array (2 C,): node i is the sum of nodes 2 i and
# 2 i + 1, node 1 the root, and nodes from C on the leaves. Parents are always added up anew from
# their children: nothing drifts, and a leaf may be set twice at once.

# A float32 number tells about 2²³ places of the total apart. Below so many levels a draw takes a
# second one, or the leaves of low priority in a large tree would be drawn wrongly or never.
LEVELS_AT_ONCE = 10


def empty(capacity: int) -> jax.Array:
    """A tree of zeros with at least `capacity` leaves."""
    return jnp.zeros(2 << max(capacity - 1, 1).bit_length(), jnp.float32)


def total(tree: jax.Array) -> jax.Array:
    """The sum of all leaves."""
    return tree[1]


def get_leaves(tree: jax.Array, leaves: jax.Array) -> jax.Array:
    """What the leaves of these numbers hold."""
    return tree[leaves + tree.size // 2]


def set_leaves(tree: jax.Array, leaves: jax.Array, priorities: jax.Array) -> jax.Array:
    """Sets leaves (M,) to priorities (M,), 0 or more.

    Of a leaf that is named twice one of the priorities holds, and the sums above are right.
    """
    nodes = leaves + tree.size // 2

    def up(_: int, carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        tree, nodes = carry
        nodes = nodes // 2
        return tree.at[nodes].set(tree[2 * nodes] + tree[2 * nodes + 1]), nodes

    return jax.lax.fori_loop(0, depth_of(tree), up, (tree.at[nodes].set(priorities), nodes))[0]


def draw(tree: jax.Array, key: jax.Array, number: int, stratified: bool) -> jax.Array:
    """Leaves (number,) drawn with P = p / Σ p (Schaul et al. 2016, Eq. 1), with replacement.

    Args:
        stratified: takes one draw from each of `number` equal parts of the total (their §3.3),
            else all independently.
    """
    uniform = jax.random.uniform(key, (number,))
    if stratified:
        uniform = (jnp.arange(number) + uniform) / number
    depth = depth_of(tree)
    nodes, mass = descend(
        tree, jnp.ones(number, jnp.int32), uniform * total(tree), min(depth, LEVELS_AT_ONCE)
    )
    if depth > LEVELS_AT_ONCE:
        mass = jax.random.uniform(jax.random.fold_in(key, 1), (number,)) * tree[nodes]
        nodes, _ = descend(tree, nodes, mass, depth - LEVELS_AT_ONCE)
    return nodes - tree.size // 2


def depth_of(tree: jax.Array) -> int:
    """Levels between the root and the leaves."""
    return (tree.size // 2).bit_length() - 1


def descend(tree: jax.Array, nodes: jax.Array, mass: jax.Array, levels: int) -> tuple[jax.Array, jax.Array]:
    """So many levels down from nodes (M,), to where the mass (M,) lies, and what is left of it there.

    That is where the running sum of priorities first exceeds it. A leaf of priority 0 is never found while
    there is another.
    """

    def down(_: int, carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        nodes, mass = carry
        left, right = tree[2 * nodes], tree[2 * nodes + 1]
        # Where rounding has left more mass than there is, the last leaf with any is meant.
        go_left = (mass < left) | (right == 0)
        return 2 * nodes + jnp.where(go_left, 0, 1), jnp.where(go_left, mass, mass - left)

    return jax.lax.fori_loop(0, levels, down, (nodes, mass))
