"""Devices: how many there are to share the work, and where compiled programs are kept."""

from __future__ import annotations

import contextlib
import os

import jax
import platformdirs

from pecjax.errors import InputError


def use_all_cores() -> None:
    """Makes every core that this process may use a device of its own on JAX's CPU back-end.

    Call it before JAX is first used (in a notebook: in the first cell); an accelerator, where
    there is one, is used as ever.
    """
    with contextlib.suppress(RuntimeError):  # JAX has started, and keeps the devices that it has
        jax.config.update("jax_num_cpu_devices", num_cores())


def num_cores() -> int:
    """How many CPU cores this process may use, as far as the system tells."""
    count = getattr(os, "process_cpu_count", None)  # since Python 3.13
    if count is None and hasattr(os, "sched_getaffinity"):  # not on macOS
        return len(os.sched_getaffinity(0))
    return (count or os.cpu_count)() or 1


def keep_compiled_programs() -> str:
    """Turns on JAX's persistent compilation cache in the user's cache folder; returns the folder."""
    folder = os.path.join(platformdirs.user_cache_dir("pecjax"), "compiled")
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    if jax.config.jax_logging_level in (None, "NOTSET"):
        # XLA warns of every program it loads that LLVM's tuning hints are no features of this
        # machine, in lines of 3,000 characters (jax issue 38445); the programs run all the same.
        jax.config.update("jax_logging_level", "CRITICAL")
    return folder


def compiler_options(*, runs_once: bool = False) -> dict[str, int]:
    """XLA's options for a program: on a CPU, less work by LLVM, which makes our programs no slower.

    Args:
        runs_once: then it matters least how fast it runs.
    """
    if jax.default_backend() != "cpu":
        return {}
    return {"xla_backend_optimization_level": 0 if runs_once else 1}


def choose_num_devices(wanted: int | None, device_divisor: int, divided: str = "runs") -> int:
    """How many devices share the work: as wanted, or as many as divide it.

    Args:
        device_divisor: how many equal parts it can be cut into.
        divided: what these parts are.

    Raises:
        InputError: fewer than 1 wanted, more than there are, or a number that does not divide.
    """
    available = len(jax.devices())
    if jax.process_count() > 1:  # one without a device would have nothing to do
        wanted = available if wanted is None else wanted
        if wanted != available:
            raise InputError(f"devices is {wanted}; the processes have {available}, leave --devices out")
    if wanted is None:
        return max(d for d in range(1, available + 1) if device_divisor % d == 0)
    if not 1 <= wanted <= available:
        raise InputError(f"devices is {wanted}; this machine has {available}, give 1 to {available}")
    if device_divisor % wanted:
        raise InputError(
            f"{device_divisor} {divided} cannot be shared evenly by {wanted} devices; change either"
        )
    return wanted


def advice_on_idle_devices(num_envs: int, device_divisor: int, divided: str, num_devices: int) -> str:
    """How all devices could be used where the number of equal parts leaves some idle, else nothing.

    Args:
        device_divisor, divided: as in `choose_num_devices`.
    """
    available = len(jax.devices())
    if num_devices == available or device_divisor % available == 0:
        return ""
    if device_divisor != num_envs:
        return f"; they share the work by its {device_divisor} {divided}"
    below = num_envs // available * available
    near = [str(number) for number in (below, below + available) if number]
    return f"; --num-envs {' or '.join(near)} would use all of them"


def check_memory(needed: int, num_devices: int, what: str, advice: str) -> None:
    """Makes sure that so many bytes, spread over devices, can be had at all.

    Args:
        what: takes them, for the message.
        advice: how to need fewer.

    Raises:
        InputError: they cannot.
    """
    limits = jax.local_devices()[0].memory_stats() or {}
    there = limits.get("bytes_limit", 0) * num_devices
    there = there or os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > there:
        raise InputError(
            f"{what} take {needed / 1e9:.1f} GB and there are {there / 1e9:.1f} GB of memory; {advice}"
        )
