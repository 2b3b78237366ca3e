"""Scenarios over devices, those of other processes too: the last axis is split, nothing is exchanged while a run lasts."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

AXIS = "scenarios"


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def mesh_for(count: int) -> Mesh:
    """Devices that a number of scenarios is spread over: as many of each process, the largest number that divides it.

    Raises:
        ValueError: it is no multiple of the number of processes.
    """
    own: dict[int, list[Any]] = {}
    for device in jax.devices():
        own.setdefault(device.process_index, []).append(device)
    fits = [k for k in range(1, min(map(len, own.values())) + 1) if count % (k * len(own)) == 0]
    if not fits:
        raise ValueError(f"batch must be a multiple of the number of processes, {len(own)}, got {count}")
    return Mesh(np.array([device for devices in own.values() for device in devices[: fits[-1]]]), (AXIS,))


def everywhere(count: int) -> NamedSharding | None:
    """Of arrays that each device of ``mesh_for`` has whole; None where there is only one."""
    mesh = mesh_for(count)
    return None if mesh.size == 1 else NamedSharding(mesh, PartitionSpec())


def over_scenarios(fun: Callable[[Any, Any], Any], count: int) -> Callable[[Any, Any], Any]:
    """``fun(shared, split)`` with the last axis of every leaf of ``split``, and of the result, spread over the devices.

    ``count`` is the number of scenarios, see ``mesh_for``. Differentiable in ``split``.
    """
    mesh = mesh_for(count)
    if mesh.size == 1:
        return fun

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
