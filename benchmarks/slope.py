"""Is the gradient that is timed a gradient? A tiny case in float64 against finite differences."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import arms, workloads
from jaxftc.compile.jit import jit
from jaxftc.config import Config
from jaxftc.robot.model_file import compile_robot
from jaxftc.scenarios.scenario import trail
from jaxftc.schemes.defaults import default_gains
from tuning import transform
from tuning.problem import CLIP, Problem
from tuning.terms import OBJECTIVE

STEP = 1e-5  # in theta


def slope_error() -> float:
    """Largest relative error of a scenario's slope along its own gradient, two hinges, 30 ticks, healthy and faulty.

    A gradient that was cut to ``CLIP`` must be a slope of at least that.
    """
    with jax.enable_x64(True):
        config = Config(compile_robot("arm2", arms.serial(2)), engine="chain", duration=0.03)
        gains, batch = default_gains(config), 4
        problem = Problem(config, OBJECTIVE, jax.random.key(workloads.NOISE), batch)
        space = transform.space(config, gains, transform.select(config))
        scenarios, one = trail(workloads.drawn(config, batch)), jnp.ones(())
        before = jnp.full((len(OBJECTIVE), batch), jnp.inf)  # no term is worse: the loss is the objective
        _, slopes = jit(problem.slope(space, "reverse"))(problem.key, jnp.zeros(space.size), one, scenarios, before)
        length = jnp.sqrt((slopes * slopes).sum(0))
        terms, along = jit(problem.at(space)), slopes / length
        up, down = (
            np.asarray(problem.weights @ np.asarray(terms(problem.key, sign * STEP * along, one, scenarios)))
            for sign in (1, -1)
        )
        wanted = (up - down) / (2 * STEP)
        return float(np.abs(np.minimum(wanted, CLIP) / np.asarray(length) - 1).max())
