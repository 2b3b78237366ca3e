"""Programs that outlive their process: found again where nothing has changed, and only there."""

import dataclasses
import functools
import os
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc import kept
from jaxftc.compile import jit
from tuning import transform
from tuning.problem import Problem
from tuning.terms import OBJECTIVE, Term

X = jnp.arange(512.0).reshape(2, 256)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(kept, "folder", tmp_path / "programs")
    return tmp_path / "programs"


def doubled(origin, traced):
    """A new function object each time, as another process has; ``traced`` grows when it is traced."""

    def fun(x, y):
        traced.append(1)
        return {"a": 2 * x + y["b"]}

    return jit(fun, origin=origin)


def called(origin="one", x=X):
    """How often a fresh function is traced when it is called."""
    traced = []
    fun = doubled(origin, traced)
    for _ in range(2):
        np.testing.assert_allclose(fun(x, {"b": 1.0})["a"], 2 * x + 1)
    return len(traced)


def test_a_program_is_found_again_without_tracing(folder):
    assert called() == 1
    assert called() == 0
    assert len(list(folder.iterdir())) == 1


def test_nothing_is_kept_without_a_folder_or_an_origin(folder, monkeypatch):
    assert [called(None), called(None)] == [1, 1]
    monkeypatch.setattr(kept, "folder", None)
    assert [called(), called()] == [1, 1]
    assert not folder.exists()


def test_what_differs_is_another_program(folder, monkeypatch):
    assert called() == 1
    assert called("two") == 1
    assert called(x=X[:, :128]) == 1
    assert called(x=X.astype(jnp.float32)) == 1
    for what, value in (("_installation", lambda: "another version"), ("_circumstances", lambda: "another machine")):
        with monkeypatch.context() as patch:
            patch.setattr(kept, what, value)
            assert called() == 1
    with monkeypatch.context() as patch:
        patch.setenv("XLA_FLAGS", "--xla_another_flag=true")  # read by XLA when it starts, by the name of the program now
        assert called() == 1
    assert called() == 0


def test_the_source_counts(tmp_path, monkeypatch):
    (tmp_path / "a.py").write_text("x = 1")
    monkeypatch.setattr(jaxftc, "__path__", [str(tmp_path)])
    before = kept._installation.__wrapped__()
    assert before == kept._installation.__wrapped__()
    (tmp_path / "a.py").write_text("x = 2")
    assert before != kept._installation.__wrapped__()


def test_a_damaged_program_is_made_anew(folder):
    assert called() == 1
    path = next(folder.iterdir())
    whole = path.read_bytes()
    for damaged in (b"", whole[:1000], whole[:-1] + b"?"):
        path.write_bytes(damaged)
        assert called() == 1
        assert called() == 0


def test_a_folder_that_cannot_be_written_costs_time_only(folder):
    folder.write_text("in the way")
    assert [called(), called()] == [1, 1]


def test_a_program_that_cannot_be_kept_costs_time_only(folder, monkeypatch):
    def refused(program):
        raise ValueError("Compilation does not support serialization")

    monkeypatch.setattr(kept.serialize_executable, "serialize", refused)
    assert [called(), called()] == [1, 1]


def test_the_programs_used_longest_ago_go_first(folder, monkeypatch):
    monkeypatch.setattr(kept, "MOST", 2)
    assert [called("a"), called("b")] == [1, 1]
    for path in folder.iterdir():
        os.utime(path, (0, time.time() - 1000))
    assert [called("a"), called("c")] == [0, 1]
    assert [called("c"), called("a"), called("b")] == [0, 0, 1]


def test_the_cache_of_jax_is_as_it_was(folder, tmp_path):
    before = jax.config.jax_compilation_cache_dir
    called()
    assert jax.config.jax_compilation_cache_dir == before


CHANGES = {
    "duration": 0.02,
    "dt": 5e-4,
    "t_final": 0.5,
    "engine": "mjx",
    "scheme": "momentum",
    "observer": "eso",
    "control": "esmc",
    "order_a": 2,
    "order_b": 3,
    "input": "torque",
    "rules": "s_only",
    "sign": "hard",
    "alarm_ticks": 4,
    "release_ticks": 11,
    "kick_ticks": 61,
}


def test_the_origin_of_a_problem_tells_its_config_objective_and_batch(puma):
    config = jaxftc.Config(puma, engine="chain", duration=0.01)
    assert set(CHANGES) | {"robot"} == {field.name for field in dataclasses.fields(config)}

    def origin(config=config, objective=OBJECTIVE, batch=4):
        return Problem(config, objective, jax.random.key(0), batch).origin

    heavier = OBJECTIVE | {"delay": OBJECTIVE["delay"]._replace(weight=2.0)}
    fewer = {name: term for name, term in OBJECTIVE.items() if name != "delay"}
    origins = [origin(), origin(objective=heavier), origin(objective=fewer), origin(batch=5)]
    origins += [origin(dataclasses.replace(config, **{name: value})) for name, value in CHANGES.items()]
    other = dataclasses.replace(puma, fingerprint="another arm")
    origins += [origin(dataclasses.replace(config, robot=other))]
    assert len(set(origins)) == len(origins) and origin() == origin()
    delay = OBJECTIVE["delay"].value
    strangers = (lambda run: jnp.zeros(()), functools.wraps(delay)(lambda run: 2 * delay(run)), functools.partial(delay))
    assert [origin(objective=OBJECTIVE | {"mine": Term(1.0, mine)}) for mine in strangers] == [None] * 3


def test_the_origin_of_a_space_tells_every_number_of_its_start(puma):
    config = jaxftc.Config(puma, engine="chain", duration=0.01)
    start = jaxftc.default_gains(config)
    leaves, tree = jax.tree.flatten(start)
    names = transform.select(config)
    origins = {transform.Space(config, start, (), 0).origin}
    for k, leaf in enumerate(leaves):
        changed = np.array(leaf)
        changed.flat[-1] = np.nextafter(changed.flat[-1], np.inf)
        gains = jax.tree.unflatten(tree, [*leaves[:k], changed, *leaves[k + 1 :]])
        origins.add(transform.Space(config, gains, (), 0).origin)
    assert len(origins) == 1 + len(leaves)
    whole, part = transform.space(config, start, names), transform.space(config, start, names[1:])
    assert len({whole.origin, part.origin, transform.space(config, start, names, ["control"]).origin}) == 3
