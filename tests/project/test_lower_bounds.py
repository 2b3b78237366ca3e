"""The dependencies: bounds that are said once, the releases that are wrong, and one way through all of them.

Short, so that CI can also run it on the lowest versions that ``pyproject.toml`` allows, and on the newest.
"""

import json
import os
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export
from jax.sharding import AxisType, PartitionSpec
from packaging.requirements import Requirement

import jaxftc
from jaxftc import logs

PROJECT = tomllib.loads((Path(jaxftc.__file__).parents[1] / "pyproject.toml").read_text())["project"]
GROUPS = {"core": PROJECT["dependencies"]} | PROJECT["optional-dependencies"]
DEPENDENCIES = [(group, Requirement(text)) for group, texts in GROUPS.items() for text in texts]

# Two hinges; the first link's inertial frame is turned by a right angle about z, so that ixx and iyy change places.
TURNED = """
<robot name="turned">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.1 0 0" rpy="0 0 1.5707963267948966"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="60" velocity="3"/><dynamics damping="1" friction="0.2"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="30" velocity="3"/><dynamics damping="1" friction="0.2"/></joint>
</robot>
"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("arm") / "turned.urdf"
    path.write_text(TURNED)
    return path


# What pyproject.toml says.


@pytest.mark.parametrize(("group", "requirement"), DEPENDENCIES, ids=str)
def test_every_dependency_has_a_lower_bound_that_is_kept(group, requirement):
    assert requirement.name == "jaxftc" or {each.operator for each in requirement.specifier} & {">=", "=="}
    if group not in ("cluster", "dev", "gym"):  # tests of ray and gymnasium are skipped where they are not installed
        assert version(requirement.name) in requirement.specifier


def test_a_package_has_one_bound_in_all_extras():
    bounds: dict[str, set[str]] = {}
    for _, requirement in DEPENDENCIES:
        bounds.setdefault(requirement.name, set()).add(str(requirement.specifier))
    assert {name: found for name, found in bounds.items() if len(found) > 1} == {}


def test_the_jax_that_computes_wrong_numbers_stays_out():
    assert "0.10.2" not in next(each.specifier for _, each in DEPENDENCIES if each.name == "jax")  # test_jax_regression.py


# What the bounds are for.


def test_a_turned_inertial_frame_of_a_urdf_is_read(arm):
    """MuJoCo before 3.14 loses the rotation, and says nothing."""
    about_the_origin = np.diag([0.03, 0.02, 0.01]) + 2 * 0.1**2 * np.diag([0, 1, 1])
    np.testing.assert_allclose(jaxftc.load_robot(arm).links[0].inertia, about_the_origin, atol=1e-9)


def test_a_barrier_has_derivatives_and_a_batch():
    """``x**3`` behind a barrier is still ``x**3``."""
    cube = lambda x: jax.lax.optimization_barrier(x) ** 3  # noqa: E731
    x = jnp.arange(3.0)
    np.testing.assert_allclose(jax.jit(jax.vmap(jax.grad(cube)))(x), 3 * x**2)
    np.testing.assert_allclose(jax.jit(jax.vmap(lambda x: jax.jvp(cube, (x,), (1.0,))[1]))(x), 3 * x**2)


def test_a_program_survives_export(tmp_path):
    pytest.importorskip("flatbuffers", reason="JAX writes exported programs with it")
    shape = jax.ShapeDtypeStruct((3,), jnp.float64)
    file = tmp_path / "program"
    file.write_bytes(export.export(jax.jit(jax.vmap(jnp.sin)))(shape).serialize(vjp_order=1))
    program, x = export.deserialize(bytearray(file.read_bytes())), jnp.arange(3.0)
    np.testing.assert_allclose(program.call(x), np.sin(x))
    np.testing.assert_allclose(jax.grad(lambda x: program.call(x).sum())(x), np.cos(x))


def test_a_program_is_spread_over_devices():
    mesh = jax.make_mesh((1,), ("scenarios",), axis_types=(AxisType.Auto,))  # Explicit by default since 0.10
    over = PartitionSpec("scenarios")
    spread = jax.shard_map(lambda x: 2 * x, mesh=mesh, in_specs=over, out_specs=over)
    np.testing.assert_array_equal(jax.jit(spread)(jnp.arange(4.0)), 2 * np.arange(4.0))


# One way through: every command that computes, on the arm from the file, one after the other. Other tests have them one by
# one, so this is slow, and for the lowest versions.


@pytest.fixture(scope="module")
def results(arm, request) -> Path:
    """The folder in which the commands below leave their results; compiled programs stay in pytest's cache."""
    environment = os.environ | {"XDG_CACHE_HOME": str(request.config.cache.mkdir("lower-bounds"))}
    for line in (
        "simulate --scenario healthy --duration 0.3 --engine chain",
        "tune --observer pi --control smc --only control --steps 1 --batch 16 --validation 2 --held-out 2 --duration 0.2",
        "campaign -n 4 --duration 0.2 --gains runs/tune-1/gains.toml",
    ):
        command = [sys.executable, "-c", "from jaxftc.cli.main import main; main()", *line.split(), "--robot", arm.name]
        done = subprocess.run(command, cwd=arm.parent, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"jaxftc {line}\n{done.stdout}{done.stderr}"
    return arm.parent / "runs"


@pytest.mark.slow
def test_a_simulated_run_is_quiet_and_its_log_reads_back(arm, results):
    config = jaxftc.Config(jaxftc.load_robot(arm), engine="chain", duration=0.3)
    result = json.loads((results / "simulate-1" / "result.json").read_text())
    assert result["isolated"] is True and result["false_alarm_s"] is None
    log = logs.read(results / "simulate-1" / "trace.parquet", config)
    chex.assert_shape([log.q, log.tau], (300, 2))
    out = logs.diagnose(config, jaxftc.default_gains(config), log)
    assert not np.asarray(out.detected).any()


@pytest.mark.slow
def test_tuned_gains_read_back(arm, results):
    config = jaxftc.Config(jaxftc.load_robot(arm), engine="chain")
    chex.assert_tree_all_finite(jaxftc.load_gains(results / "tune-1" / "gains.toml", config))
    assert "</html>" in (results / "tune-1" / "report.html").read_text()


@pytest.mark.slow
def test_a_campaign_counts_its_scenarios(results):
    found = json.loads((results / "campaign-1" / "summary.json").read_text())
    assert (found["n"], found["diverged"]) == (4, 0)
