"""Scenarios over devices: the last axis is split, nothing is exchanged while a run lasts."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, PartitionSpec

AXIS = "scenarios"


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def devices_for(count: int) -> int:
    """Devices that a number of scenarios is spread over: the largest number of them that divides it."""
    return next(d for d in range(min(len(jax.local_devices()), count), 0, -1) if count % d == 0)


def over_scenarios(fun: Callable[[Any, Any], Any], count: int) -> Callable[[Any, Any], Any]:
    """``fun(shared, split)`` with the last axis of every leaf of ``split``, and of the result, spread over the devices.

    ``count`` is the number of scenarios, see ``devices_for``. Differentiable in ``split``.
    """
    use = devices_for(count)
    if use == 1:
        return fun
    mesh = Mesh(np.asarray(jax.local_devices()[:use]), (AXIS,))

    def last_axis(leaf: Any) -> PartitionSpec:
        return PartitionSpec(*[None] * (leaf.ndim - 1), AXIS)

    def call(shared: Any, split: Any) -> Any:
        shape = jax.eval_shape(fun, shared, split)
        return jax.shard_map(
            fun,
            mesh=mesh,
            in_specs=(PartitionSpec(), jax.tree.map(last_axis, split)),
            out_specs=jax.tree.map(last_axis, shape),
            check_vma=False,
        )(shared, split)

    return call
