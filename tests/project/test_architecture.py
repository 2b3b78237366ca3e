"""The map of the package, read from its imports: arrows go one way, and importing is quick and changes nothing."""

import ast
import importlib
import inspect
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import jaxftc
import tuning
from jaxftc.variants import SCHEMES

ROOT = Path(jaxftc.__file__).parents[1]
FLOORS = ("jaxftc", "tuning", "benchmarks", "tests")  # each may import those before it
PUBLIC = sorted(jaxftc._HOME)


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for floor in FLOORS[:3] for path in sorted((ROOT / floor).rglob("*.py"))}
OURS = {name: path for name, path in MODULES.items() if name.split(".")[0] == "jaxftc" and path.stem != "__main__"}


def targets(node: ast.Import | ast.ImportFrom) -> set[str]:
    """Modules that an import names; of `from a import b` both a and, where that is a module, a.b."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    assert node.level == 0, "relative imports hide the map"
    return {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}


def imports(name: str, *, at_load: bool = False) -> set[str]:
    """Everything that a module imports; with at_load what it imports when it is loaded, functions and type checks apart."""
    nodes, found = [ast.parse(MODULES[name].read_text())], set()
    if name == "jaxftc.schemes.registry":  # imports what the table says
        found |= set(SCHEMES.values())
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            found |= targets(node)
        elif not (at_load and runs_later(node)):
            nodes += ast.iter_child_nodes(node)
    return found


def runs_later(node: ast.AST) -> bool:
    """Whether what is inside does not run when the module is loaded."""
    if isinstance(node, ast.If):
        return "TYPE_CHECKING" in ast.unparse(node.test)
    return isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)


def neighbours(name: str, *, at_load: bool = False) -> set[str]:
    return {target for target in imports(name, at_load=at_load) if target in MODULES and target != name}


def reachable(name: str) -> set[str]:
    """Modules that are there once `name` has run, its own parents apart."""
    seen, new = set(), {name}
    while new:
        seen |= new
        new = set().union(*(neighbours(module) for module in new)) - seen
    return seen


def within(module: str, *rooms: str) -> bool:
    return any(module == f"jaxftc.{room}" or module.startswith(f"jaxftc.{room}.") for room in rooms)


def test_there_is_something_to_read():
    assert {"jaxftc.schemes.cascade", "jaxftc.simulation.closed_loop", "jaxftc.robot.mjx"} <= MODULES.keys()
    assert {"jaxftc.observer.cascade", "jaxftc.schemes.ekf"} <= reachable("jaxftc.schemes.registry")


def test_arrows_between_packages_go_one_way():
    for name in MODULES:
        allowed = FLOORS[: FLOORS.index(name.split(".")[0]) + 1]
        wrong = {
            target for target in imports(name) if target.split(".")[0] in FLOORS and target.split(".")[0] not in allowed
        }
        assert not wrong, f"{name} imports {sorted(wrong)}; it may import {allowed}"


def room(module: str) -> str:
    return module.split(".")[1]


def drawn() -> list[list[str]]:
    """The rooms of ``jaxftc`` as CONTRIBUTING.md draws them, floor by floor, the highest first."""
    picture = (ROOT / "CONTRIBUTING.md").read_text().partition("```text rooms\n")[2].partition("```")[0]
    return [line.split() for line in picture.splitlines()]


def test_every_room_is_in_the_picture():
    listed = [name for floor in drawn() for name in floor]
    assert sorted(listed) == sorted({room(name) for name in OURS if name != "jaxftc"})


def test_arrows_between_rooms_go_down():
    """A room may import those of lower floors: no circles, and nothing that is used from below."""
    floors = {name: k for k, floor in enumerate(reversed(drawn())) for name in floor}
    for name in OURS.keys() - {"jaxftc"}:
        for target in neighbours(name) - {"jaxftc"}:
            if target.startswith("jaxftc.") and room(target) != room(name):
                assert floors[room(target)] < floors[room(name)], f"{name} imports {target}, which is not below it"


def test_the_tick_reaches_neither_plant_nor_faults():
    """The wall, by imports: what runs on a robot cannot name a scenario, a fault or the closed loop."""
    for name in [name for name in OURS if within(name, "schemes", "realtime")]:
        wrong = {module for module in reachable(name) if within(module, "scenarios", "simulation", "evaluation", "logs")}
        assert not wrong, f"{name} reaches {sorted(wrong)}"


@pytest.mark.parametrize("name", ["jaxftc.numerics.smooth", "jaxftc.types", "jaxftc.version"])
def test_leaves_import_no_room(name):
    assert neighbours(name) <= {"jaxftc", "jaxftc.types"}


def test_one_file_imports_mjx():
    users = [name for name in MODULES if any(target.startswith("mujoco.mjx") for target in imports(name))]
    assert users == ["jaxftc.robot.mjx"]


def test_optax_descends_for_gains_and_for_a_decision_s_weights_alone():
    users = [name for name in MODULES if any(target.split(".")[0] == "optax" for target in imports(name))]
    assert set(users) <= {"tuning.decision", "tuning.descent"}, users


def test_no_cycle_of_imports():
    done: set[str] = set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, " -> ".join((*path[path.index(name) :], name))
        if name not in done:
            for neighbour in sorted(neighbours(name, at_load=True)):
                visit(neighbour, (*path, name))
            done.add(name)

    for name in MODULES:
        visit(name, ())


@pytest.mark.parametrize("package", [jaxftc, tuning], ids=lambda package: package.__name__)
def test_type_checkers_and_python_see_the_same_public_names(package):
    name, version = package.__name__, {("__version__", "jaxftc.version")} if package is jaxftc else set()
    rooms = ("export", "faults", "identify", "logs", "observer", "realtime")
    modules = {("metrics", "jaxftc.evaluation")} | {(room, "jaxftc") for room in rooms}
    modules = modules if package is jaxftc else set()
    stub = ast.parse((ROOT / name / "__init__.pyi").read_text())
    nodes = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    seen = {(alias.asname, node.module) for node in nodes for alias in node.names}
    assert seen == {(public, f"{name}.{room}") for public, room in package._HOME.items()} | version | modules
    assert dir(package) == sorted([*(public for public, _ in version | modules), *package._HOME])
    for public, room in package._HOME.items():
        assert getattr(package, public) is getattr(importlib.import_module(f"{name}.{room}"), public)


@pytest.mark.parametrize("name", PUBLIC)
def test_public_names_load_and_explain_themselves(name):
    value = getattr(jaxftc, name)
    home = importlib.import_module(f"jaxftc.{jaxftc._HOME[name]}")
    assert value is getattr(home, name)
    if callable(value):
        assert value.__module__ == home.__name__, "the home of a name is where it is written"
        text = inspect.getdoc(value)
        assert text and not text.startswith(f"{name}("), "a docstring of its own, not the one that Python makes up"


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'jaxftc' has no attribute 'simulat'"):
        _ = jaxftc.simulat


def python(program: str) -> str:
    """What a fresh interpreter prints."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment, cwd=ROOT.anchor)
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_importing_the_package_loads_neither_jax_nor_mujoco():
    loaded = json.loads(python("import json, sys, jaxftc; jaxftc.__version__; print(json.dumps(sorted(sys.modules)))"))
    assert "jaxftc" in loaded
    assert not {"jax", "jaxlib", "mujoco", "numpy", "scipy"} & set(loaded)


def test_modules_are_there_after_importing_the_package():
    program = """
import sys, jaxftc
assert jaxftc.observer.stability.spectral_radius and jaxftc.identify.fit_batch and jaxftc.logs.read
assert jaxftc.metrics is jaxftc.metrics is sys.modules["jaxftc.evaluation.metrics"]
print(set(jaxftc._MODULES) <= set(dir(jaxftc)))
"""
    assert python(program) == "True\n"


def test_python_m_is_the_command():
    assert python("import runpy, sys; sys.argv[1:] = ['--version']; runpy.run_module('jaxftc', run_name='__main__')") == (
        f"jaxftc {jaxftc.__version__}\n"
    )


def test_importing_every_module_and_running_both_engines_changes_no_jax_setting_and_prints_nothing():
    program = """
import importlib, json, jax
before = dict(jax.config.values)
for name in NAMES: importlib.import_module(name)
jax.config.update("jax_num_cpu_devices", jax.config.values["jax_num_cpu_devices"])  # refused once a backend has started
import jaxftc
from benchmarks.arms import serial
from jaxftc.robot.model_file import compile_robot
arm, run = compile_robot("arm", serial(2)), jax.jit(jaxftc.forward_dynamics, static_argnums=0, static_argnames="engine")
for engine in ("chain", "mjx"): run(arm, *[jax.numpy.zeros(2)] * 3, engine=engine)
print(json.dumps({k: str(v) for k, v in jax.config.values.items() if k in before and before[k] is not v}))
"""
    names = [name for name in OURS if name != "jaxftc.faults.gym"]  # which needs an extra
    assert json.loads(python(program.replace("NAMES", repr(names)))) == {}


@pytest.mark.parametrize("room", ["observer", "diagnosis", "control", "schemes", "fuzzy"])
def test_no_controller_depends_on_settings_of_the_simulation(room):
    """What is simulated, for how long and by what, is none of a robot's controller's business."""
    read = {
        f"{name}: {node.attr}"
        for name, path in OURS.items()
        if within(name, room)
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute) and node.attr in {"engine", "t_final", "duration", "ticks"}
    }
    assert not read


def test_nobody_asks_which_scheme_it_has():
    """What differs from scheme to scheme, the scheme says."""
    asked = {
        f"{name}:{node.lineno}"
        for name, path in MODULES.items()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Compare)
        and any(isinstance(part, ast.Attribute) and part.attr == "scheme" for part in (node.left, *node.comparators))
        and any(isinstance(part, ast.Constant) for part in (node.left, *node.comparators))
    }
    assert not asked
