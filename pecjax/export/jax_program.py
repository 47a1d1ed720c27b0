"""The policy as a program of JAX: StableHLO that `jax.export.deserialize` reads."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator

import jax
import jax.numpy as jnp
from jax import export

from pecjax.export.policy import Policy, evaluate

PLATFORMS = ("cpu", "cuda", "rocm", "tpu")


def jax_program(policy: Policy) -> bytes:
    """The serialized program: a dictionary of inputs (B, …) by name to one of outputs, for any B."""
    (batch,) = export.symbolic_shape("batch")
    inputs = {
        name: jax.ShapeDtypeStruct((batch, *box.shape), jnp.float32) for name, box in policy.inputs.items()
    }
    with _without_source_lines():
        program = export.export(jax.jit(functools.partial(evaluate, policy)), platforms=PLATFORMS)(inputs)
    return bytes(program.serialize())


@contextlib.contextmanager
def _without_source_lines() -> Iterator[None]:
    """While it is entered, programs do not name the source files of this machine, as they otherwise do."""
    name = "jax_traceback_in_locations_limit"
    before = getattr(jax.config, name)
    jax.config.update(name, 0)
    try:
        yield
    finally:
        jax.config.update(name, before)
