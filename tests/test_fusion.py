"""The plan: it changes no number, and puts fences where work would be repeated."""

import gc

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxftc
from jaxftc import compile as compiling
from jaxftc.closed_loop import watch
from jaxftc.faults.scenario import trail
from jaxftc.fusion import evaluate as evaluating
from jaxftc.fusion.evaluate import evaluate, stack_shapes
from jaxftc.fusion.plan import plan
from jaxftc.fusion.rewrite import planned
from tests.arms import three_hinges

LANES = 64


def fences(fun, *args):
    """Number of fences in the plan of a function without loops."""
    return len(plan(jax.make_jaxpr(fun)(*args)).fenced)


def steps(fun, *args):
    return [step.primitive.name for step in plan(jax.make_jaxpr(fun)(*args)).steps]


OPERATIONS = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: jnp.tanh(a) * b,
    "div": lambda a, b: a / (1 + b * b),
    "sin": lambda a, b: jnp.sin(a) + a.sum(0),
    "stack": lambda a, b: jnp.stack([a[0] * b[1], b[0] + a[1], a[2]]),
    "max": lambda a, b: jnp.maximum(a, b.max(0)),
    "where": lambda a, b: jnp.where(a > b, a, 0.5 * b),
}


@given(
    st.lists(st.tuples(st.sampled_from(sorted(OPERATIONS)), st.integers(0, 99), st.integers(0, 99)), min_size=1, max_size=40)
)
def test_a_planned_program_gives_the_same_numbers(operations):
    """Random programs of arithmetic, joins, splits and sums over the leading axis."""

    def fun(x, y):
        values = [x, y]
        for name, i, j in operations:
            values.append(OPERATIONS[name](values[i % len(values)], values[j % len(values)]))
        return values[-1], sum(values)

    x, y = jnp.linspace(-1, 1, 3 * LANES).reshape(3, LANES), jnp.linspace(2, 0.1, 3 * LANES).reshape(3, LANES)
    ours = evaluate(plan(jax.make_jaxpr(fun)(x, y)), [x, y])
    for a, b in zip(ours, fun(x, y), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)


def test_a_costly_value_with_many_readers_is_stored_and_a_cheap_one_is_not():
    x = jnp.ones((6, 512))

    def readers(value):
        return [jnp.exp(value), jnp.exp(-value), jnp.exp(2 * value), jnp.exp(3 * value)]

    assert fences(lambda x: readers(jnp.sin(x)), x) == 1
    assert fences(lambda x: jnp.sin(x) * x, x) == 0
    assert fences(lambda x: readers(x + 1), jnp.ones(8)) == 0


def test_what_is_not_stored_is_part_of_every_loop_that_uses_it():
    """XLA would store a value with several uses where loops may have several results."""

    def fun(x):
        cheap = x + 1
        return cheap * 2, cheap * 3

    program = plan(jax.make_jaxpr(fun)(jnp.ones(8)))
    assert [[program.steps[k].primitive.name for k in loop] for loop in program.loops] == [["add", "mul"], ["add", "mul"]]
    text = str(jax.make_jaxpr(planned(fun))(jnp.ones(8)))
    assert text.count("add") == 2


def test_without_fences_everything_is_computed_once():
    program = plan(jax.make_jaxpr(lambda x: ((x + 1) * 2, (x + 1) * 3))(jnp.ones(8)), fences=False)
    assert [len(loop) for loop in program.loops] == [1] * len(program.steps)


def test_a_value_that_ends_in_one_loop_is_not_stored():
    assert fences(lambda x: jnp.sin(x) * 2 + jnp.sin(x) * jnp.sin(x), jnp.ones((6, 512))) == 0


def test_parts_of_a_joined_array_are_stored_and_so_is_the_array():
    x = jnp.ones((2, 512))
    assert fences(lambda x: jnp.stack([x[0] * x[1], x[0] + x[1]]) * 2, x) == 3


def test_an_array_that_is_computed_and_taken_apart_is_stored():
    x = jnp.ones((2, 512))
    assert fences(lambda x: (x + 1)[0] * (x + 1)[1], x) == 1
    assert fences(lambda x: x[0] * x[1], x) == 0


@pytest.mark.parametrize(
    "fun",
    [
        lambda x, y: (jnp.tanh(x) * y[:, None] - 2.0 * x).sum(0),
        lambda x, y: (jnp.tanh(x) * x[:1]).max(0) * y[0],
        lambda x, y: jnp.where(x > jnp.broadcast_to(x.min(0), x.shape), jnp.exp(x), 0.5).sum(0) + y[1],
        lambda x, y: jnp.broadcast_to(jnp.sin(x)[:, None], (2, 3, LANES)).sum((0, 1)),
    ],
)
def test_the_terms_of_a_sum_are_computed_one_by_one(fun):
    """Of what is given or stored, parts are taken; what is computed in the loop is computed for each part."""
    x, y = jnp.linspace(-1, 1, 2 * LANES).reshape(2, LANES), jnp.array([0.5, 0.25])
    traced = jax.make_jaxpr(planned(fun))(x, y)
    taken = {eqn.invars[0] for eqn in traced.eqns if eqn.primitive.name == "slice"}
    computed = {v for eqn in traced.eqns if eqn.primitive.name not in ("optimization_barrier", "slice") for v in eqn.outvars}
    assert taken and not taken & computed
    np.testing.assert_allclose(jax.jit(planned(fun))(x, y), fun(x, y), rtol=1e-12)


def test_a_value_used_many_times_in_a_term_is_computed_once():
    def fun(x):
        for _ in range(12):
            x = x * x - 0.5 * x
        return x.sum(0)

    assert len(jax.make_jaxpr(planned(fun))(jnp.ones((2, LANES))).eqns) < 200


def test_what_a_loop_is_given_a_tick_is_stored_where_it_is_taken_apart():
    x = jnp.linspace(1, 2, 4 * 2 * LANES).reshape(4, 2, LANES)

    def barriers(body):
        text = str(jax.make_jaxpr(planned(lambda x: jax.lax.scan(body, jnp.zeros(LANES), x)))(x))
        return text.count("optimization_barrier")

    assert barriers(lambda carry, x: (carry + x[0] * x[1], None)) == 1
    assert barriers(lambda carry, x: (carry + x.sum(), None)) == 0


def test_a_loop_over_little_compiles_with_fences():
    def small_loop(large, x):
        def body(x, _):
            joined = jnp.stack([jnp.sin(x[0]) * x[1], x[0] + x[1]])
            return jnp.stack([joined[1], jnp.tanh(joined[0])]), x

        return large * jax.lax.scan(body, x, None, length=5)[1].sum()

    large, x = jnp.ones((4, LANES)), jnp.array([0.5, 0.25])
    np.testing.assert_allclose(jaxftc.jit(small_loop)(large, x), small_loop(large, x), rtol=1e-6)


@pytest.mark.parametrize("spread", [False, True])
@pytest.mark.parametrize("reverse", [False, True])
def test_a_loop_in_a_loop_is_handed_the_stacks_of_the_last_turn(monkeypatch, spread, reverse):
    """Whatever they hold is overwritten: every turn gives what it gives on its own."""
    monkeypatch.setattr(evaluating, "LARGE", 100)
    mesh = jax.sharding.Mesh(np.asarray(jax.devices()[:1]), ("lanes",))

    def inner(x):
        def body(carry, k):
            carry = jnp.cos(carry) + k
            return carry, (carry * x, carry > 1)

        return jax.lax.scan(body, x, jnp.arange(5.0), reverse=reverse)

    if spread:
        last = jax.sharding.PartitionSpec("lanes")
        stack = jax.sharding.PartitionSpec(None, "lanes")
        inner = jax.shard_map(inner, mesh=mesh, in_specs=last, out_specs=(last, (stack, stack)), check_vma=False)

    def outer(x):
        def turn(x, k):
            x, (y, big) = inner(x * k)
            return x, (y.sum(0), big[2])

        return jax.lax.scan(turn, x, jnp.arange(1.0, 4.0))

    x = jnp.linspace(0, 1, LANES)
    program = plan(jax.make_jaxpr(outer)(x))
    (turn,) = program.bodies.values()
    assert [sorted(size for size, _ in each) for each in stack_shapes(turn).values()] == [[(*[1] * spread, 5, LANES)] * 2]
    for ours, theirs in zip(evaluate(program, [x]), jax.tree.leaves(outer(x)), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)


def test_there_are_few_fences_around_a_loop_and_the_usual_ones_in_it():
    def fun(x):
        joined = jnp.stack([x[0] * x[1], x[0] + x[1]])
        return jax.lax.scan(lambda carry, _: (jnp.stack([carry[0] * carry[1], carry[0]]), None), joined, None, length=2)[0]

    program = plan(jax.make_jaxpr(fun)(jnp.ones((2, 512))))
    (body,) = program.bodies.values()
    assert (len(program.fenced), len(body.fenced)) == (0, 2)


def test_the_garbage_collector_is_as_it_was():
    seen = []
    try:
        for on in (False, True):
            (gc.enable if on else gc.disable)()
            compiling.jit(lambda x: (seen.append(gc.isenabled()), x)[1])(jnp.ones(3))
            with pytest.raises(ZeroDivisionError):
                compiling.jit(lambda x: x / (1 // 0))(jnp.ones(3))
            assert gc.isenabled() == on
    finally:
        gc.enable()
    assert seen and not any(seen)


def test_what_nothing_uses_is_left_out_and_the_same_operation_is_done_once():
    x = jnp.ones((2, 512))
    assert "sin" not in steps(lambda x: (jnp.sin(x), jnp.exp(x))[1], x)
    assert steps(lambda x: jnp.sin(x) + jnp.sin(x), x).count("sin") == 1


def test_loops_branches_calls_and_static_arguments_pass():
    def fun(x, times, *, shift):
        def body(carry, k):
            carry = jax.lax.cond(k > 1, jnp.sin, jnp.cos, carry) + shift
            return carry, carry.sum(0)

        last, sums = jax.lax.scan(jax.checkpoint(body), x, jnp.arange(times), reverse=True)
        return {
            "last": jax.nn.softmax(last, axis=0),
            "sums": sums,
            "while": jax.lax.fori_loop(0, times, lambda i, v: v + i, x),
        }

    x = jnp.linspace(0, 1, 3 * LANES).reshape(3, LANES)
    ours = jaxftc.jit(fun, static_argnums=1, static_argnames="shift")(x, 4, shift=0.5)
    jax.tree.map(np.testing.assert_allclose, ours, fun(x, 4, shift=0.5))


def test_the_closed_loop_is_the_same_with_and_without_a_plan():
    """In double precision, on enough scenarios to need fences."""
    config = jaxftc.Config(three_hinges(), engine="chain", duration=0.06)
    gains, key = jaxftc.default_gains(config), jax.random.key(0)
    scenarios = trail(jaxftc.sample_scenarios(jax.random.key(1), LANES, config=config))

    def run(scenarios):
        return watch(config, gains, scenarios, key, (), lambda seen, tick: (seen, (tick.q, tick.out.tau, tick.out.verdict)))[
            1
        ]

    assert any(body.fenced for body in plan(jax.make_jaxpr(run)(scenarios)).bodies.values())
    ours = jax.jit(planned(run), compiler_options=compiling.compiler_options())(scenarios)
    theirs = jax.jit(run, compiler_options=compiling.compiler_options(small=True))(scenarios)
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-7)


def test_gradients_are_the_same_with_and_without_a_plan():
    arm = three_hinges()
    q = jnp.linspace(-1, 1, arm.n * LANES).reshape(arm.n, LANES)

    def slope(q):
        return jax.grad(lambda q: (jaxftc.forward_dynamics(arm, q, 0.5 * q, 10 * q, "chain") ** 2).sum())(q)

    assert fences(slope, q) > 0
    ours = jax.jit(planned(slope), compiler_options=compiling.compiler_options())(q)
    theirs = jax.jit(slope, compiler_options=compiling.compiler_options(small=True))(q)
    np.testing.assert_allclose(ours, theirs, rtol=1e-9)


def test_programs_on_large_arrays_are_planned_and_small_ones_are_not(monkeypatch):
    seen = []
    monkeypatch.setattr(compiling, "planned", lambda fun: lambda *args: (seen.append(args[0].shape), fun(*args))[1])
    double = compiling.jit(lambda x: 2 * x)
    for shape in ((6,), (6, LANES)):
        assert double(jnp.ones(shape)).shape == shape
    assert seen == ([(6, LANES)] if jax.default_backend() == "cpu" else [])


def test_where_loops_have_several_results_no_program_is_small(monkeypatch):
    monkeypatch.setattr(compiling, "whole", lambda fun: pytest.fail("takes minutes to compile"))
    monkeypatch.setenv("XLA_FLAGS", "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion=true")
    assert compiling.jit(lambda x: 2 * x)(jnp.ones(6)).shape == (6,)


@pytest.mark.parametrize("alone", [False, True])
def test_a_program_that_runs_one_a_core_is_not_spread(alone):
    passes = compiling.compiler_options(alone=alone).get("xla_disable_hlo_passes", "")
    assert ("cpu-parallel-task-assigner" in passes) == (alone and jax.default_backend() == "cpu")


@pytest.mark.parametrize("small", [False, True])
def test_an_option_that_xla_does_not_know_is_left_out(monkeypatch, small):
    for name in ("_WHOLE", "_PLANNED"):
        monkeypatch.setattr(compiling, name, {"xla_no_such_option": True})
    compiling.compiler_options.cache_clear()
    try:
        assert compiling.compiler_options(small=small) == {}
        assert compiling.jit(jnp.sin)(jnp.ones((6, LANES))).shape == (6, LANES)
    finally:
        compiling.compiler_options.cache_clear()
