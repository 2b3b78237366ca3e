"""The benchmark suites' arithmetic on cases with a known answer, and their peers; the suites themselves run as commands."""

import dataclasses
import functools
import json
import math
import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import jax
import mujoco
import numpy as np
import pytest

import jaxftc
from benchmarks import (
    arms,
    baseline,
    chart,
    clock,
    curves,
    kernels,
    metrics,
    ranking,
    results,
    sizes,
    speed,
    speed_page,
    workloads,
)
from benchmarks import report as bench_report
from benchmarks.cli import ranking_text, tuning_text
from benchmarks.curves import Curve
from benchmarks.peers import dynamics, mujoco_c, numpy_loop, urdf
from benchmarks.slope import slope_error
from benchmarks.worker import environment
from jaxftc.cli.main import main
from jaxftc.compile.xla import FLAGS, with_flag
from jaxftc.robot.model_file import compile_robot
from jaxftc.simulation.closed_loop import encoder_noise
from tuning import Progress, Settings
from tuning.settings import GRADIENT_COST, METHODS

LOOP = """
HloModule one

%fused (param_0: f32[2,8], param_1: f32[5,8], param_2: s32[]) -> (f32[8], f32[5,8]) {
  %param_0 = f32[2,8]{1,0} parameter(0)
  %slice.1 = f32[1,8]{1,0} slice(%param_0), slice={[0:1], [0:8]}
  %bitcast.1 = f32[8]{0} bitcast(%slice.1)
  %exp.1 = f32[8]{0} exponential(%bitcast.1)
  %bitcast.2 = f32[1,8]{1,0} bitcast(%exp.1)
  %param_1 = f32[5,8]{1,0} parameter(1)
  %param_2 = s32[] parameter(2)
  %constant.1 = s32[] constant(0)
  %dynamic-update-slice.1 = f32[5,8]{1,0} dynamic-update-slice(%param_1, %bitcast.2, %param_2, %constant.1)
  ROOT %tuple.1 = (f32[8]{0}, /*index=1*/f32[5,8]{1,0}) tuple(%exp.1, %dynamic-update-slice.1)
}

%body (arg: (s32[], f32[2,8], f32[5,8])) -> (s32[], f32[2,8], f32[5,8]) {
  %arg = (s32[], f32[2,8]{1,0}, f32[5,8]{1,0}) parameter(0)
  %k = s32[] get-tuple-element(%arg), index=0
  %x = f32[2,8]{1,0} get-tuple-element(%arg), index=1
  %stack = f32[5,8]{1,0} get-tuple-element(%arg), index=2
  %fusion.1 = (f32[8]{0}, f32[5,8]{1,0}) fusion(%x, %stack, %k), kind=kLoop, calls=%fused
  %copy.1 = f32[2,8]{1,0} copy(%x)
  ROOT %tuple.2 = (s32[], f32[2,8]{1,0}, f32[5,8]{1,0}) tuple(%k, %copy.1, %stack)
}

ENTRY %main (x: f32[2,8]) -> f32[2,8] {
  %x.1 = f32[2,8]{1,0} parameter(0)
  %negate.1 = f32[2,8]{1,0} negate(%x.1)
  %while.1 = (s32[], f32[2,8]{1,0}, f32[5,8]{1,0}) while(%negate.1), condition=%less, body=%body
  ROOT %out = f32[2,8]{1,0} get-tuple-element(%while.1), index=1
}
"""


def test_kernels_operations_and_numbers_moved_are_counted(monkeypatch):
    """Of an array that a part is taken of, the part; of a stack that a row is written to, the row."""
    monkeypatch.setattr(kernels, "FEW", 0)
    assert kernels.count(LOOP, scenarios=8) == [
        kernels.Turn("loop 1", 2, operations=8, read=1 + 1 / 8 + 2, written=2 + 2),
        kernels.Turn("around", 1, operations=2, read=2, written=2),
    ]


def test_kernels_of_what_xla_compiles_are_found(monkeypatch):
    monkeypatch.setattr(kernels, "FEW", 0)
    compiled = jax.jit(lambda x: jax.lax.scan(lambda c, _: (jax.numpy.sin(c) @ x, None), x, length=9)[0]).lower(np.eye(4))
    first, *_ = kernels.count(compiled.compile().as_text(), scenarios=1)
    assert first.loop == "loop 1" and first.kernels >= 2 and first.operations >= 16 * 20


def curve(method, seed, objective):
    points = len(objective)
    return Curve(method, seed, np.arange(points) * 100.0, np.arange(points) * 2.0, np.array(objective), 1.0)


@pytest.fixture
def found():
    slow = {"cmaes": [3.0, 2.5, 2.0], "random": [3.0, 2.9, 2.8], "finite": [3.0, 3.0, 3.0]}
    return [curve(m, s, slow.get(m, [3.0, 2.0 + s, 1.0])) for s in (0, 1) for m in METHODS]


def test_how_much_sooner_the_gradient_is_there(found):
    verdicts = curves.verdicts(found)
    assert verdicts["cmaes"]["gradient_needs_times_fewer"] == [2.0, 1.0]  # at 100 of 200, at 200 of 200
    assert verdicts["random"]["gradient_needs_times_fewer"] == [2.0, 1.0]
    assert verdicts["finite"]["gradient_needs_times_fewer"] == [None, None]  # no better than the start
    assert verdicts["finite"]["gradient_needs_times_fewer_median"] is None
    assert verdicts["gradient"]["final_median"] == 1.0 and verdicts["gradient"]["simulations"] == 200.0
    assert curves.reached(found[0], 0.5) == np.inf and curves.reached(found[0], 2.0, "seconds") == 2.0
    text, page = tuning_text(5.0, verdicts), bench_report.curves_page(found, 5.0, {})
    assert (
        "a gradient counts as 5.0 simulations" in text
        and "2.0, 1.0" in text
        and "not better than the start" in text
        and "held-out objective" in page
    )


def test_a_curve_counts_gradients_at_their_measured_cost_and_leaves_out_compilation():
    settings = Settings(steps=20, batch=10)
    path = []
    for k in range(1, 5):
        step = 5 * k
        spent = step * 10 * (GRADIENT_COST + 1) + 100 * k
        path.append((Progress(step, 20, spent, 30.0 + 2.0 * (k - 1), 0.0, 0.0, 0.0, 0.0), step))
    made = curves._curve("gradient", 3, path, GRADIENT_COST + 2.0, settings, lambda step: 1.0 / step, 9.0)
    assert made.simulations[-1] == 20 * 10 * (GRADIENT_COST + 3) + 400
    assert made.objective[0] == 9.0 and made.objective[-1] == 0.05
    assert made.compile_s == 28.0 and made.seconds.tolist()[-1] == 8.0
    other = curves._curve("random", 3, path, GRADIENT_COST + 2.0, settings, lambda step: 1.0, 9.0)
    assert other.simulations[-1] == path[-1][0].simulations
    assert curves._curve("finite", 3, path[:1], 5.0, settings, lambda step: 1.0, 9.0).compile_s is None


def test_ratios_are_paired_and_named():
    random = np.random.default_rng(0)
    was = np.exp(random.normal(size=200))
    assert ranking._pair("tracking", 1, "smc", "esmc", was, 0.9 * was, 0.0).word == "falls"
    assert ranking._pair("tracking", 1, "smc", "esmc", was, 1.1 * was, 0.0).word == "rises"
    noisy = ranking._pair("tracking", 1, "smc", "esmc", was, was * np.exp(random.normal(size=200)), 0.0)
    assert noisy.word == "tie" and noisy.ratio.low < 1 < noisy.ratio.high


def test_controllers_are_read_off_where_they_chatter_alike():
    """Tracking is 1 over chattering for each; at the level of ESMC the second is twice as good as the first."""
    level = ranking.SWEEP[:, None] * np.linspace(1.0, 2.0, 40)
    chattering = {"smc": 3 * level, "esmc": level, "afesmc": 0.7 * level}
    tracking = {"smc": 2 / (3 * level), "esmc": 1 / level, "afesmc": 1 / (0.7 * level)}
    made = {name: np.stack([chattering[name], tracking[name]]) for name in chattering}
    pairs = list(ranking._tracking(made, np.arange(40) % 4))
    assert len(pairs) == 8 and all(pair.louder == 0 and pair.n == 10 for pair in pairs)
    for pair in pairs:
        assert pair.ratio.value == pytest.approx(0.5 if pair.before == "smc" else 1.0, rel=1e-9)
    made["smc"][0] += 100.0  # cannot be made as calm
    assert all(pair.louder == 1.0 for pair in ranking._tracking(made, np.arange(40) % 4) if pair.before == "smc")
    notes = {"surface": {"lowest": 0.5}}
    assert "falls" in ranking_text(pairs, notes) and "lowest 0.500" in bench_report.ranking_page(pairs, notes, {})


def test_a_run_that_diverged_has_a_huge_error_not_none():
    assert (ranking._error(np.array([0.5, 1.0, 10.0])) == np.array([1.0, 1e6 - 1, 1e6 - 1])).tolist()[0]
    assert np.isfinite(ranking._error(np.array([1.0, 10.0]))).all()


def test_surfaces_of_known_shape(config):
    gains = jaxftc.default_gains(config)
    flat = gains.replace({"control.outputs": 1.5})
    assert ranking.surface(config, flat).lowest == pytest.approx(1.5) == ranking.surface(config, flat).highest
    by_s = ranking.surface(dataclasses.replace(config, rules="s_only"), gains)
    assert by_s.by_s == pytest.approx(1.0) and by_s.by_q == pytest.approx(0.0, abs=1e-12)
    printed = ranking.surface(config, gains)
    assert 0.5 <= printed.lowest < 0.7 and 2.3 < printed.highest <= 2.5 and printed.by_s < 0.2


PROMISED = {  # the keys that design and README promise
    "plant_chain_over_c", "loop_chain_over_c", "loop_mjx_over_mjx_default", "loop_over_numpy", "grad_over_forward",
    "compile_forward_s", "compile_grad_s", "tick_p50_us", "tick_p99_us", "campaign_10k_s",
}  # fmt: skip


@pytest.fixture
def arm3():
    return compile_robot("arm3", arms.serial(3))


@pytest.fixture
def figures():
    values = {metric.key: 10.0 ** (2 + k % 6) for k, metric in enumerate(metrics.METRICS)}
    table = results.Table("By cores", ("cores", "closed loop", "compile s"), [(1, 5e5, 2.0), (2, 1e6, 2.0)])
    return results.Results(values, {"cores": table, "batch": table}, [results.Check("plant", 1e-6, 1e-3)])


def test_the_table_of_figures_is_whole():
    assert metrics.TABLE.keys() >= PROMISED and len(metrics.TABLE) == len(metrics.METRICS)
    assert set(metrics.expected(metrics.SECTIONS, quick=True)) >= PROMISED
    assert set(speed.SECTIONS) == set(metrics.SECTIONS)
    for metric in metrics.METRICS:
        assert metric.direction in ("higher", "lower") and metric.about and metric.unit
        gated = metric.tolerance is not None
        assert not gated or (metric.unit in ("times", "GiB") and 0 < metric.tolerance < 1), (
            "only what does not drift is gated"
        )


@pytest.mark.parametrize("key", ["plant_chain_over_c", "grad_over_forward"])  # one that should rise, one that should fall
def test_the_gate_lets_pass_what_is_as_good_and_stops_what_is_worse(key):
    before = dict.fromkeys(metrics.gated(), 4.0)
    tolerance, rises = metrics.gated()[key], metrics.TABLE[key].direction == "higher"
    worse, better = (-1, 1) if rises else (1, -1)
    for change, stopped in ((0.0, 0), (0.99 * worse, 0), (1.01 * worse, 1), (50 * better, 0), (math.nan, 1)):
        lines = baseline.compare(before, before | {key: 4.0 * (1 + change * tolerance)})
        assert len(lines) == stopped and all(line.startswith(f"{key} is ") for line in lines)


def test_the_gate_stops_at_what_is_missing_on_either_side():
    values = dict.fromkeys(metrics.gated(), 4.0)
    less = {key: value for key, value in values.items() if key != "loop_over_numpy"}
    assert baseline.compare(values, less) == ["loop_over_numpy is missing from this run; the baseline has 4.0"]
    assert "loop_over_numpy is missing from the baseline" in baseline.compare(less, values)[0]
    assert len(baseline.compare(values, {})) == len(values)


def test_a_lucky_baseline_does_not_stop_a_perfect_run():
    before = dict.fromkeys(metrics.gated(), 4.0) | {"campaign_linearity": 0.8}
    assert baseline.compare(before, before | {"campaign_linearity": 1.0}) == []
    assert len(baseline.compare(before, before | {"campaign_linearity": 1.2})) == 1


def test_a_child_is_given_every_flag_but_the_commands_own(monkeypatch, tmp_path):
    flags = "--xla_a=1 --xla_backend_extra_options=xla_b=2"
    monkeypatch.setenv("XLA_FLAGS", functools.reduce(with_flag, FLAGS, flags))
    assert environment(tmp_path)["XLA_FLAGS"] == flags


def test_the_committed_baseline_is_of_the_committed_results():
    committed, whole = baseline.load(), json.loads(baseline.RESULTS.read_text())
    values = {row["key"]: row["value"] for row in whole["metrics"]}
    assert committed["metrics"] == {key: values[key] for key in metrics.gated()}
    assert committed["machine"] == whole["machine"] and committed["machine"]["processor"]
    assert chart.PATH.read_text() == chart.draw(whole), "python -m benchmarks.chart"


def test_a_baseline_is_written_whole_or_not_at_all(tmp_path, figures):
    paths = tmp_path / "baseline.json", tmp_path / "results.json"
    result = {"machine": {"cores": 2}, **speed_page.as_dict(figures, sizes.FULL, jaxftc.Config(jaxftc.puma560()))}
    baseline.save(result, *paths)
    assert baseline.compare(baseline.load(paths[0])["metrics"], figures.metrics) == []
    del result["metrics"][0]
    with pytest.raises(ValueError, match="needs every section; this run lacks plant_chain_over_c"):
        baseline.save(result, *paths)
    assert baseline.load(paths[0])["machine"] == {"cores": 2}
    with pytest.raises(ValueError, match=r"no baseline in .*; write one with --update-baseline"):
        baseline.load(tmp_path / "none.json")


@pytest.mark.parametrize("option", ["--gate", "--update-baseline"])
def test_a_quick_run_is_no_baseline(option, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("jaxftc.cli.common.prepare", lambda options, **settings: None)
    with pytest.raises(SystemExit) as stop:
        main(["bench", "--quick", option])
    assert stop.value.code == 2 and "--quick has other sizes than the baseline" in capsys.readouterr().err


@pytest.mark.thorough
@pytest.mark.parametrize("torque", [5.0, 18.0])  # the second drives the wrist into its limits
@pytest.mark.parametrize("coulomb", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_loop_in_numpy_is_the_library_s(torque, coulomb):
    config = jaxftc.Config(jaxftc.puma560(coulomb=coulomb), engine="chain", duration=0.3)
    gains, scenario, key = (
        jaxftc.default_gains(config),
        jaxftc.paper_scenario("both", config, torque=torque),
        jax.random.key(3),
    )
    trace = jaxftc.simulate(config, gains, scenario, key)
    made = numpy_loop.simulate(config, gains, scenario, np.asarray(encoder_noise(config, scenario, key)))
    np.testing.assert_allclose(made.tau, trace.out.tau, atol=1e-7)
    np.testing.assert_allclose(made.q, trace.q, atol=1e-10)
    np.testing.assert_array_equal(made.verdict, trace.out.verdict)
    limited = (np.abs(made.tau) >= config.robot.torque_limit).any()
    assert made.verdict.max() == 3 and limited == (torque > 5)


def test_the_controller_in_numpy_refuses_what_it_does_not_have(config):
    with pytest.raises(ValueError, match=r"has the default structure only, got .*'pi'"):
        numpy_loop.Controller(dataclasses.replace(config, observer="pi"), jaxftc.default_gains(config), np.zeros(6))


def test_plants_move_alike(arm3):
    config = jaxftc.Config(arm3, engine="chain", duration=0.05)
    begin = workloads.starts(config, 6)
    (first, second) = workloads.plant(config, begin, 3, 2)()
    ours = [np.concatenate([a, b], axis=-1) for a, b in zip(first, second, strict=True)]
    rollout = mujoco_c.Rollout(arm3, config.dt, config.ticks, 6, 2)
    rollout.load(*begin)
    for mine, theirs in zip(ours, rollout(), strict=True):
        np.testing.assert_allclose(mine, np.moveaxis(theirs, 0, -1), atol=1e-10)
    rollout.close()
    np.testing.assert_allclose(mujoco_c.Step(arm3, config.dt, config.ticks)(*begin)[0], ours[0][-1], atol=1e-10)
    assert np.abs(ours[0][-1] - begin.q).max() > 1e-3, "they do move"


def test_libraries_are_given_the_same_arm(arm3, tmp_path):
    """As URDF, and as whatever is installed takes it."""
    (tmp_path / "arm.urdf").write_text(urdf.as_urdf(arm3))
    again = jaxftc.load_robot(tmp_path / "arm.urdf")
    q, qd, qdd = np.random.default_rng(0).normal(size=(3, 3, 5))
    motor = arm3.armature[:, None] * qdd + arm3.damping[:, None] * qd
    links = jaxftc.inverse_dynamics(arm3, q, qd, qdd) - motor
    np.testing.assert_allclose(jaxftc.inverse_dynamics(again, q - arm3.q_zero[:, None], qd, qdd), links, atol=1e-9)
    for peer in dynamics.peers(arm3):
        if dynamics.installed(peer):
            tau = links + motor
            np.testing.assert_allclose(peer.make(arm3, 2)(q.T, qd.T, tau.T), qdd.T, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("n", [1, 2, 7])
def test_arms_of_any_number_of_hinges(n):
    robot = compile_robot("arm", arms.serial(n))
    assert robot.n == n and np.isfinite(robot.torque_limit).all()
    assert mujoco.MjModel.from_xml_string(robot.mjcf).nv == n


def test_sides_run_in_turn_and_the_least_time_counts(monkeypatch):
    now, calls = [0.0], []
    monkeypatch.setattr(clock.time, "perf_counter", lambda: now[0])

    def side(name, *seconds):
        left = list(seconds)

        def call():
            calls.append(name)
            now[0] += left.pop(0)
            return len(left)

        return call

    laps = clock.race({"a": side("a", 9.0, 2.0, 3.0), "b": side("b", 5.0, 1.0, 0.5)}, 2)
    assert calls == ["a", "b"] * 3
    assert laps["a"] == (2.0, 9.0, 0) and laps["b"] == (0.5, 5.0, 0)


def test_a_wrong_result_is_no_figure(figures):
    for error in (2e-3, math.nan):
        with pytest.raises(results.Failed, match="what was timed is wrong: angles is off by"):
            figures.check("angles", error, 1e-3)
    assert results.apart([1.0, np.nan], [1.0, 1.0]) == math.inf == results.apart([1.0], [1.0, 1.0])
    assert results.apart([1.0, 2.0], [1.0, 2.5]) == 0.5


def test_a_section_that_forgets_a_figure_is_found(monkeypatch, tmp_path):
    monkeypatch.setitem(
        speed.SECTIONS, "tick", lambda setup, results: results.metrics.update(tick_p50_us=1.0, tick_p99_us=1.0)
    )
    setup = results.Setup(None, sizes.FULL, 2, tmp_path)
    with pytest.raises(results.Failed, match=r"not measured: .*tick_p999_us"):
        speed.run(setup, ["tick"])


def test_results_as_text_page_and_json(figures, config):
    text, page = speed_page.as_text(figures), speed_page.page(figures, {})
    assert all(key in text and key in page for key in metrics.TABLE)
    assert "By cores" in text and "500,000" in text and "1 checks" in text and "Checks of what was timed" in page
    rows = json.loads(json.dumps(speed_page.as_dict(figures, sizes.QUICK, config)))
    assert rows["quick"] is True and rows["tables"]["cores"]["rows"][1] == {"cores": 2, "closed loop": 1e6, "compile s": 2.0}
    assert {"key", "value", "unit", "direction"} <= rows["metrics"][0].keys()


def test_the_chart_is_drawn_to_scale(figures, config):
    result = {"machine": {"processor": "A & B", "cores": 2}, **speed_page.as_dict(figures, sizes.FULL, config)}
    picture = ElementTree.fromstring(chart.draw(result))
    space = {"svg": "http://www.w3.org/2000/svg"}
    texts = [element.text for element in picture.iterfind("svg:text", space)]
    bars = {}
    for (key, label, _), bar in zip(
        (row for rows in chart.GROUPS.values() for row in rows), picture.iterfind("svg:rect[@y]", space), strict=True
    ):
        assert label in texts and chart.short(figures.metrics[key]) in texts
        bars[figures.metrics[key]] = float(bar.get("width"))
    lengths = [bars[value] for value in sorted(bars)]
    np.testing.assert_allclose(
        np.diff(lengths) / np.diff(np.log10(sorted(bars))), lengths[-1] / (max(np.log10(list(bars))) - 2), rtol=0.01
    )
    assert [chart.short(v) for v in (549.4, 4407.0, 1.234e6)] == ["549", "4.41 k", "1.23 M"]


@pytest.mark.slow
def test_the_gradient_that_is_timed_is_a_slope():
    assert slope_error() < 1e-4


def quick(folder, *words):
    """The result of a quick run of the command."""
    command = [sys.executable, "-c", "from jaxftc.cli.main import main; main()", "bench", "--quick", "--json", *words]
    environment = os.environ | {"XDG_CACHE_HOME": str(folder / "cache")}
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.thorough
def test_both_engines_are_compiled_as_xla_can(tmp_path):
    """With the command's flags, XLA before 0.12 ends the process on MJX in a batch unless it is compiled as such."""
    rows = quick(tmp_path, "--sections", "dynamics")["tables"]["dynamics"]["rows"]
    speeds = {row["library"]: row["arms/s"] for row in rows}
    assert speeds["jaxftc, chain"] > 0 and speeds["jaxftc, mjx"] > 0


@pytest.mark.slow
def test_a_quick_run_measures_everything(tmp_path):
    result = quick(tmp_path)
    measured = {row["key"]: row["value"] for row in result["metrics"]}
    assert measured.keys() >= PROMISED and all(np.isfinite(value) and value > 0 for value in measured.values())
    assert result["machine"]["cores"] and len(result["checks"]) > 10
    assert {"kernels", "starts", "dynamics", "batch", "horizon", "cores", "joints"} <= result["tables"].keys()
    assert "svg" in (tmp_path / "runs" / "bench-speed-1" / "report.html").read_text()
