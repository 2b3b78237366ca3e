"""The compiler layer: what XLA makes of our programs, what happens when an option is gone, and programs from the cache."""

import dataclasses
import os
import stat
import subprocess
import sys
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import jaxftc
from jaxftc import stages
from jaxftc.compile import jit as programs
from jaxftc.compile import program_cache
from jaxftc.compile import xla as compiling
from jaxftc.numerics.barrier import stack, store, unstack
from jaxftc.scenarios.scenario import trail
from jaxftc.simulation.closed_loop import rollout, run_loop
from tests.arms import two_hinges

KERNELS = 450  # a tick of three hinges without loops of several results; 250 to 330 on the versions seen


@pytest.fixture(scope="module")
def short() -> jaxftc.Config:
    return jaxftc.Config(two_hinges(), engine="chain", duration=0.02, t_final=0.02)


def scenarios(config, count):
    return trail(jaxftc.sample_scenarios(jax.random.key(0), count, config=config))


def test_the_compiled_loop_keeps_its_barriers_and_has_few_kernels(short):
    """A renamed pass or option would make programs slower and change nothing else: this is where it shows."""
    options = compiling.options("batch")
    assert options == {option.name: option.value for option in (compiling.STORE, compiling.VECTORS)}
    args = stages.as_data(short), jaxftc.default_gains(short), scenarios(short, 256), jax.random.key(0)
    lowered = jax.jit(run_loop, static_argnums=0, compiler_options=options).lower(short, *args)
    from benchmarks import kernels

    text = lowered.compile().runtime_executable().hlo_modules()[0].to_string()
    assert text.count(" opt-barrier(") > 20
    turn = max(kernels.count(text, 256), key=lambda turn: turn.kernels if turn.loop else 0)
    assert 50 < turn.kernels < KERNELS, f"{turn.kernels} kernels a tick"


def test_a_single_arm_becomes_one_function(short):
    options = compiling.options("one arm")
    assert options == {compiling.ONE_FUNCTION.name: compiling.ONE_FUNCTION.value}
    one = jax.tree.map(lambda leaf: leaf[..., 0], scenarios(short, 1))
    args = stages.as_data(short), jaxftc.default_gains(short), one, jax.random.key(0)
    marked = compiling.as_one_function(lambda *rest: run_loop(short, *rest))
    text = jax.jit(marked, compiler_options=options).lower(*args).compile().as_text()
    (entry,) = [part for part in text.split("\n\n") if part.lstrip().startswith("ENTRY")]
    assert " call(" in entry and " while(" not in entry, "the loop over time is inside the function"


def test_barriers_change_no_number_and_have_derivatives_both_ways():
    def plain(x):
        return jnp.stack([row * row.sum() for row in x]).sum(0)

    def ours(x):
        return stack([store(row * row.sum()) for row in unstack(x)]).sum(0)

    x = jnp.linspace(-1.0, 2.0, 12).reshape(3, 4)
    np.testing.assert_allclose(jax.jit(ours)(x), plain(x), rtol=1e-14)
    np.testing.assert_allclose(ours(x), plain(x), rtol=1e-14)
    slope = jax.jacrev(ours)(x)
    np.testing.assert_allclose(slope, jax.jacrev(plain)(x), rtol=1e-12)
    np.testing.assert_allclose(jax.jacfwd(ours)(x), slope, rtol=1e-12)
    batch = jnp.stack([x, 2 * x])
    np.testing.assert_allclose(jax.vmap(jax.jacrev(ours))(batch)[0], slope, rtol=1e-12)


def test_unstack_takes_any_axis_and_stack_puts_back():
    x = jnp.arange(24.0).reshape(2, 3, 4)
    for axis in range(3):
        rows = jax.jit(lambda x, axis=axis: unstack(x, axis))(x)
        np.testing.assert_array_equal(stack(rows, axis), x)


def test_the_reverse_of_unstack_joins_rows_that_are_stored():
    def cost(x):
        return sum((jnp.sin(row) ** 2).sum() for row in unstack(x))

    text = str(jax.make_jaxpr(jax.grad(cost))(jnp.ones((3, 4))))
    assert text.count("optimization_barrier") >= 2, text


def fake(name, value):
    return compiling.Option(name, value, "nowhere", "nothing")


def test_an_option_that_is_gone_leaves_the_numbers_and_one_warning(short, monkeypatch):
    """Refused by XLA, as a removed option is, or accepted and without effect, as a renamed pass is."""
    for option in (fake("xla_cpu_no_such_option", 1), fake("xla_disable_hlo_passes", "no_such_pass")):
        compiling.options.cache_clear()
        monkeypatch.setitem(compiling._TABLE, "batch", ((option, compiling._keeps_barriers),))
        program = programs.jit(lambda x: stack(unstack(x)[::-1]) * 2)
        with pytest.warns(RuntimeWarning, match="has no effect.*same results and run slower") as caught:
            np.testing.assert_array_equal(program(jnp.arange(3.0)), [4, 2, 0])
            np.testing.assert_array_equal(program(jnp.arange(4.0)), [6, 4, 2, 0])
        assert len(caught) == 1
    compiling.options.cache_clear()


def test_what_xla_cannot_compile_our_way_is_compiled_plainly(monkeypatch):
    monkeypatch.setattr(compiling, "options", lambda kind: {"xla_cpu_no_such_option": 1})
    program = programs.jit(lambda x, k: x.at[k].set(0.0))
    with pytest.warns(RuntimeWarning, match="could not compile .* with the library's options"):
        np.testing.assert_array_equal(program(jnp.ones(3), jnp.asarray([1])), [1, 0, 1])


def test_inside_a_caller_the_function_is_part_of_the_callers_program():
    program = programs.jit(lambda scale, x: scale * jnp.tanh(x), static_argnums=0)
    x = jnp.linspace(-1.0, 1.0, 5)
    np.testing.assert_allclose(jax.jit(lambda x: program(2, x))(x), 2 * jnp.tanh(x))
    np.testing.assert_allclose(jax.vmap(lambda x: program(2, x))(x), 2 * jnp.tanh(x))
    np.testing.assert_allclose(jax.grad(lambda x: program(2, x).sum())(x), 2 / jnp.cosh(x) ** 2)
    assert not program._programs


def test_a_program_is_made_once_for_each_kind_of_arguments():
    traced = []
    program = programs.jit(lambda x: traced.append(x.shape) or x + 1)
    for shape in ((3,), (3,), (4,)):
        program(np.ones(shape))
    program(jnp.ones(3))
    assert traced == [(3,), (4,)]
    with jax.enable_x64(False):
        assert program(np.ones(3, np.float32)).dtype == np.float32
    workers = [threading.Thread(target=program, args=(np.ones(7),)) for _ in range(8)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert traced.count((7,)) == 1


def test_a_process_that_runs_out_of_memory_maps_forgets_its_programs(monkeypatch, tmp_path):
    """XLA would end it: a program has hundreds of maps, and a process may have 65,530."""
    traced = []
    program = programs.jit(lambda x: traced.append(x.shape) or x + 1)
    program(np.ones(3))
    (tmp_path / "most").write_text("65530\n")
    monkeypatch.setattr(programs, "MOST_MAPS", tmp_path / "most")
    monkeypatch.setattr(programs, "MAPS", tmp_path / "maps")
    for lines, kept in ((52_000, 2), (53_000, 1)):
        (tmp_path / "maps").write_text("a map\n" * lines)
        program(np.ones((2, lines)))
        assert len(program._programs) == kept
    np.testing.assert_array_equal(program(np.ones(3)), 2 * np.ones(3))
    assert traced.count((3,)) == 2
    monkeypatch.setattr(programs, "MAPS", tmp_path / "none")  # other systems
    program(np.ones(4))
    assert (3,) in traced


def test_a_long_compilation_is_said(monkeypatch):
    said, messages = threading.Event(), []
    monkeypatch.setattr(programs, "PATIENCE", 0.0)
    monkeypatch.setattr(programs._log, "warning", lambda message: messages.append(message) or said.set())

    def slow(x):
        assert said.wait(10)
        return x

    programs.jit(slow)(jnp.ones(2))
    assert "compiling 'slow' for more than 0 s" in messages[0]


def test_flags_are_added_to_those_that_are_there_and_taken_out_again():
    flags = "--xla_a=1 --xla_disable_hlo_passes=mine"
    ours = compiling.with_flag(flags, compiling.STORE)
    assert ours == "--xla_a=1 --xla_disable_hlo_passes=mine,cse_barrier_expander,small-while-loop-hoisting"
    assert compiling.with_flag(ours, compiling.STORE) == ours
    assert compiling.without_flag(ours, compiling.STORE) == flags
    assert compiling.without_flag(compiling.with_flag("", compiling.SEVERAL_RESULTS), compiling.SEVERAL_RESULTS) == ""


PROGRAM = """
import warnings
warnings.simplefilter("error")
import os, jax, jax.numpy as jnp, jaxftc
if {late}: jnp.ones(3) + 1
try:
    jaxftc.configure_xla()
    jaxftc.configure_xla()
except RuntimeError as error:
    print("refused:", error, os.environ.get("XLA_FLAGS", ""))
else:
    text = jax.jit(lambda x: jax.lax.optimization_barrier(x + 1) * 2).lower(jnp.ones(8)).compile().as_text()
    print("kept" if "opt-barrier" in text else "stripped")
"""


@pytest.mark.parametrize(
    ("late", "said"), [(False, "kept"), (True, "refused: configure_xla() came after JAX was first used")]
)
def test_configure_xla_reaches_the_users_own_programs_or_says_that_it_came_too_late(late, said):
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"} | {"JAX_PLATFORMS": "cpu"}
    program = PROGRAM.format(late=late)
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment, check=False)
    assert run.stdout.startswith(said), run.stderr
    assert "--xla" not in run.stdout, "flags that are not in force are taken back"


@pytest.fixture
def cache(tmp_path, monkeypatch):
    folder = program_cache.open_folder(tmp_path / "programs")
    monkeypatch.setattr(program_cache, "folder", folder)
    return folder


def test_a_program_from_the_cache_is_not_traced_again(cache):
    traced = []

    def fun(key, x):
        traced.append(1)
        return {"a": x + jax.random.normal(key, x.shape), "b": x.sum()}

    make = lambda name: programs.jit(fun, cached_as=name, like={"a": 0, "b": 0})  # noqa: E731
    args = jax.random.key(3), jnp.arange(4.0)
    first, again = make("one")(*args), make("one")(*args)
    assert len(traced) == 1 and len(list(cache.iterdir())) == 1
    jax.tree.map(np.testing.assert_array_equal, first, again)
    jax.tree.map(np.testing.assert_array_equal, first, jax.jit(fun)(*args))
    make("another")(*args)
    make("one")(args[0], jnp.arange(5.0))
    assert len(list(cache.iterdir())) == 3, "what it closes over and shapes are part of its name"


def test_a_damaged_program_is_made_anew(cache):
    make = lambda: programs.jit(lambda x: 2 * x, cached_as="double", like=0)  # noqa: E731
    make()(jnp.ones(2))
    (path,) = cache.iterdir()
    whole = path.read_bytes()
    for data in (b"", whole[:-1], whole[:40] + bytes([whole[40] ^ 1]) + whole[41:]):
        path.write_bytes(data)
        np.testing.assert_array_equal(make()(jnp.ones(2)), [2, 2])
        program_cache._read(path)  # whole again


def test_a_cache_that_others_can_write_to_is_not_used(tmp_path, caplog):
    folder = program_cache.open_folder(tmp_path / "own")
    assert folder is not None and stat.S_IMODE(folder.stat().st_mode) == 0o700
    folder.chmod(0o770)
    assert program_cache.open_folder(folder) is None
    assert "others can write to it" in caplog.text
    folder.chmod(0o755)
    assert program_cache.open_folder(folder) == folder and stat.S_IMODE(folder.stat().st_mode) == 0o700
    (tmp_path / "file").write_text("")
    assert program_cache.open_folder(tmp_path / "file" / "inside") is None


def test_a_cache_in_which_another_user_wrote_is_not_used(tmp_path, caplog, monkeypatch):
    folder = program_cache.open_folder(tmp_path / "own")
    (folder / "planted").write_bytes(b"")
    monkeypatch.setattr(program_cache, "_ours", lambda path: path.name != "planted")
    assert program_cache.open_folder(folder) is None
    assert f"{folder / 'planted'} belongs to another user" in caplog.text


def test_a_relative_cache_home_is_ignored(monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "here")
    assert program_cache.user_folder().is_absolute()


@pytest.mark.thorough
@pytest.mark.parametrize(
    "observer", [*(pytest.param(o, marks=pytest.mark.slow) for o in ("pi", "eso", "eso_printed")), "ts"]
)
@pytest.mark.parametrize("control", ["smc", pytest.param("esmc", marks=pytest.mark.slow), "afesmc"])
def test_stages_as_data_give_what_the_config_gives(short, observer, control):
    """One program for every observer and controller, against a program that knows which."""
    config = dataclasses.replace(short, observer=observer, control=control)
    gains, some = jaxftc.default_gains(config), scenarios(config, 2)
    ours = rollout(config, gains, some, jax.random.key(0))
    known = stages.Stages(*map(bool, stages.of(config)))
    theirs = jax.jit(lambda *rest: run_loop(config, known, *rest))(gains, some, jax.random.key(0))
    for (path, a), b in zip(jax.tree_util.tree_leaves_with_path(ours), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9, err_msg=jax.tree_util.keystr(path))


def test_observers_and_controllers_share_one_program(short):
    from jaxftc.simulation.closed_loop import _PROGRAMS

    some, before = scenarios(short, 2), None
    for observer, control in (("pi", "smc"), ("eso", "esmc"), ("ts", "afesmc")):
        config = dataclasses.replace(short, observer=observer, control=control)
        rollout(config, jaxftc.default_gains(config), some, jax.random.key(0))
        count = len(_PROGRAMS["batch"]._programs)
        assert before in (None, count)
        before = count


def test_only_public_names_of_jax_are_used():
    import re
    from pathlib import Path

    root = Path(jaxftc.__file__).parents[1]
    private = re.compile(
        r"jax\.(_src|extend)|serialize_executable|^\s*(import|from) pickle\b|jax\.core import (?!Tracer$)", re.M
    )
    files = [path for room in ("jaxftc", "tuning", "benchmarks") for path in (root / room).rglob("*.py")]
    assert not [str(path) for path in files if private.search(path.read_text())]
    assert lax.optimization_barrier is not None
