"""What adding to the house takes: one file, and one line of a table."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import jaxftc

HOUSE = Path(jaxftc.__file__).parent
TWO = """
import jax, jax.numpy as jnp, numpy as np, jaxftc
from benchmarks.arms import serial
from jaxftc.robot.model_file import compile_robot
robot = compile_robot("two", serial(2))
config = jaxftc.Config(robot, engine="chain")
"""


@pytest.fixture
def house(tmp_path):
    """A copy of the package to build in, and a way to run a script on it."""
    copy = shutil.copytree(HOUSE, tmp_path / "jaxftc", ignore=shutil.ignore_patterns("__pycache__"))

    def run(script):
        path = os.pathsep.join([str(tmp_path), str(HOUSE.parent)])
        done = subprocess.run(
            [sys.executable, "-c", TWO + script],
            env=os.environ | {"PYTHONPATH": path},
            cwd=tmp_path,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    return copy, run


def insert(path, after, line):
    text = path.read_text()
    assert text.count(after) == 1
    path.write_text(text.replace(after, f"{after}\n{line}"))


@pytest.mark.thorough
def test_a_scheme_is_a_module_and_a_line(house):
    """Gravity compensation and a damper: it runs, tunes its own gain, and campaigns know its name."""
    copy, run = house
    insert(copy / "variants.py", '"ekf": "jaxftc.schemes.ekf",', '    "damper": "jaxftc.schemes.damper",')
    (copy / "schemes" / "damper.py").write_text(
        """
import jax.numpy as jnp
from jaxftc.schemes import computed_torque
from jaxftc.schemes.computed_torque import State, init
from jaxftc.types import Reference

DIAGNOSES = False


def gains_used(config):
    return {"baseline.kd"}


def step(config, gains, state, reference, measurement):
    zero = jnp.zeros_like(state.q)
    gains = gains.replace({"baseline.kp": 0.0, "baseline.speed_weight": 1.0})
    return computed_torque.step(config, gains, state, Reference(state.q, zero, zero), measurement)
"""
    )
    script = """
from jaxftc.campaigns.spec import variant
from tuning.transform import tunable
config = variant(config, "damper")
gains, q = jaxftc.default_gains(config), jnp.full(2, 0.3)
held = jaxftc.inverse_dynamics(config.robot, q, 0 * q, 0 * q)
state = jaxftc.init(config, gains, q)
with jax.disable_jit():
    out = jaxftc.step(config, gains, state, jaxftc.Reference(q, q, q), jaxftc.Measurement(q, held))[1]
print(*tunable(config), bool(jnp.allclose(out.tau, held, atol=1e-5)))
"""
    assert run(script) == ["baseline.kd", "True"]


@pytest.mark.thorough
def test_an_observer_stage_is_a_module_and_a_line(house):
    """A share of psi that follows the change of the innovation."""
    copy, run = house
    cascade = copy / "observer" / "cascade.py"
    insert(
        cascade,
        "from jaxftc.observer import arx, laguerre, pi, super_twisting, takagi_sugeno",
        "from jaxftc.observer import rate",
    )
    table = 'STAGES: dict[str, ModuleType] = {"pi": pi, "sliding": super_twisting'
    assert cascade.read_text().count(table) == 1
    cascade.write_text(cascade.read_text().replace(table, table + ', "rate": rate'))
    (copy / "observer" / "rate.py").write_text(
        """
import jax.numpy as jnp
from typing import NamedTuple
from jaxftc.types import Array


class State(NamedTuple):
    e: Array


def init(config, gains, q):
    return State(jnp.zeros_like(q))


def step(config, gains, state, inputs):
    return State(inputs.e), 100.0 * (inputs.e - state.e)
"""
    )
    script = """
gains, q = jaxftc.default_gains(config), jnp.full(2, 0.3)
state = jaxftc.init(config, gains, q)
with jax.disable_jit():
    signals = jaxftc.Reference(q, 0 * q, 0 * q), jaxftc.Measurement(q + 1e-4, state.command.tau)
    after, _ = jaxftc.step(config, gains, state, *signals)
e = after.observer.stages["rate"].e
print(bool((e > 0).all()), bool(jnp.allclose(after.psi - after.observer.fuzzy.psi, 0.0)) is False)
"""
    assert run(script) == ["True", "True"]


@pytest.mark.thorough
def test_a_kind_of_fault_is_a_line_in_two_tables_of_one_file(house):
    """A torque whose sign is wrong: presets draw it, and the plant gets it. What others draw does not change."""
    copy, run = house
    faults = copy / "scenarios" / "faults.py"
    insert(
        faults,
        '    DELAY = 9, "ticks", lambda x: x.late  # the command comes late',
        '    REVERSED = 10, "1", lambda x: -x.size * x.tau',
    )
    insert(faults, "    saturation: Share | None = None", "    reversed: Share | None = None")
    script = """
import pathlib
from jaxftc.scenarios.faults import Actuator
from jaxftc.simulation import fault_injection
path = pathlib.Path("mine.toml")
path.write_text('base = "standard"\\n[shares]\\nhealthy = 0.0\\nactuator = 1.0\\nsensor = 0.0\\nboth = 0.0\\n'
                '[actuator.reversed]\\nsize = 0.5\\n')
some = jaxftc.sample_scenarios(jax.random.key(0), 3, path, config=config)
fault = jax.tree.map(lambda leaf: leaf[0], some.fault_tau)._replace(rise=0.0, clear=jnp.inf, period=jnp.inf)
joint = int(np.flatnonzero(fault.kind)[0])
zero = jnp.zeros(2)
state, still = fault_injection.init(zero, zero, zero), fault_injection.Motion(zero, zero, zero + 1.0, config.dt)
tau = fault_injection.deliver(fault, state, jnp.asarray(0.999), jnp.full(2, 3.0), jnp.full(2, 9.0), still)[1]
standard = jaxftc.sample_scenarios(jax.random.key(0), 20, config=config)
print(Actuator(int(fault.kind[joint])).name, float(tau[joint]), float(np.sum(standard.fault_tau.magnitude)))
"""
    name, tau, drawn = run(script)
    assert (name, float(tau)) == ("REVERSED", -1.5)
    faults.write_text((HOUSE / "scenarios" / "faults.py").read_text())
    before = """
print(float(np.sum(jaxftc.sample_scenarios(jax.random.key(0), 20, config=config).fault_tau.magnitude)))
"""
    assert run(before) == [drawn]


def test_a_log_format_is_a_module_and_a_line(house):
    """NumPy's archives: a log comes back as it was written."""
    copy, run = house
    insert(copy / "logs" / "formats.py", '    ".parquet": "parquet",', '    ".npz": "archive",')
    (copy / "logs" / "archive.py").write_text(
        """
import numpy as np
from jaxftc.logs.formats import Table


def read(path):
    with np.load(path) as file:
        return Table(dict(file))
"""
    )
    script = """
t = 0.01 * np.arange(400)
q = np.stack([0.5 * np.sin(t), 0.3 * np.cos(2 * t)], 1)
np.savez("motion.npz", t=t, q1=q[:, 0], q2=q[:, 1], tau1=np.sin(3 * t), tau2=np.cos(t))
log = jaxftc.logs.read("motion.npz", robot, check=False)
print(log.dt, bool(np.allclose(log.q, q)), bool(np.allclose(log.tau[:, 1], np.cos(t), atol=1e-6)))
"""
    assert run(script) == ["0.01", "True", "True"]
