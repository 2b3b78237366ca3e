"""The figures of a tuning run show what they say."""

import jax.numpy as jnp
import numpy as np

import jaxftc
from jaxftc.report.figures import surface_figure
from tuning import OBJECTIVE, Progress, Result, report
from tuning.cli import summary
from tuning.held_out import Comparison


def test_loss_figure_has_every_term():
    rows = np.arange(3.0)
    history = {name: rows for name in (*Progress._fields, *(f"term_{name}" for name in OBJECTIVE))}
    result = Result(None, 2, history, [], "all steps done", 2, 1.0, 2, {}, {})
    names = {trace.name for trace in report.loss_figure(result).data}
    assert set(OBJECTIVE) <= names and "validation loss" in names


def test_gains_figure_shows_what_moved_and_only_that(config):
    before = jaxftc.default_gains(config)
    lam = before.control.lam * jnp.arange(1.0, 3.0)
    after = before.replace({"control.lam": lam})
    (dots,) = report.gains_figure(config, before, after).data
    assert set(dots.y) == {"control.lam"} and np.allclose(dots.x, [1, 2])
    assert dots.text[1] == "control.lam[1]: 20 to 40 1/s"


def test_the_gains_that_moved_are_printed_with_their_units(puma_config):
    before = jaxftc.default_gains(puma_config)
    kappa = before.arx.kappa_a.at[0, 0].mul(2.0)
    after = before.replace({"control.lam": np.arange(1.0, 7.0), "control.eps": 0.25, "arx.kappa_a": kappa})
    kappas, lam, eps = report.moved(before, after)
    assert " to " in kappas and kappas.split()[0] == "arx.kappa_a"
    assert lam == "  control.lam              20 -> [1 2 3 4 5 6]  1/s"
    assert eps == "  control.eps              0.5 -> 0.25  rad/s"
    assert report.moved(before, before) == []


def test_surface_figure_is_table_1(config):
    gains = jaxftc.default_gains(config)
    before, _, after, _ = surface_figure(config, {"before": gains, "after": gains}, "").data
    np.testing.assert_array_equal(before.z, after.z)
    corner = (
        before.z[0, 0],
        before.z[0, -1],
        before.z[-1, 0],
        before.z[-1, -1],
    )  # (s, q) at the ends: NB-NB, NB-PB, PB-NB, PB-PB
    np.testing.assert_allclose(corner, (2.5, 0.5, 0.5, 2.5), atol=0.05)


def test_better_and_worse_are_what_the_interval_says_and_the_objective_feels():
    """A significant rise is worse, however small a share; one of a term that was next to nothing is none."""
    draws = np.random.default_rng(1).uniform(1, 2, 400)
    names = ("rises", "falls", "scatters", "nothing")
    before = np.stack([draws, draws, draws, 0 * draws])
    after = np.stack([1.05 * draws, 0.5 * draws, np.roll(draws, 1), 2e-4 + 0 * draws])
    found = Comparison("standard", "smooth", names, np.ones(4), before, after, None, None)  # pyright: ignore[reportArgumentType]
    assert [found.word(name) for name in (*names, "objective")] == ["worse", "better", "same", "same", "better"]
    page = report._table(found)
    looks = {row.split("</td>")[0].rpartition(">")[2]: row for row in page.split("<tr>") if "<td" in row}
    assert "number no'" in looks["rises"] and "number yes'" in looks["falls"]
    assert not any(look in looks[name] for look in (" no'", " yes'") for name in ("scatters", "nothing"))
    text = summary(Result(None, 0, {}, [], "", 0, 0.0, 0, {}, {}), [found], 1)
    assert [line.split()[0] for line in text.splitlines() if "WORSE" in line] == ["rises"]


def test_what_tuning_changed_stays_on_its_axis():
    """A term that was 0 and is not, and one that was not and is: both at the ends, their bars inside."""
    names, draws = ("worse", "better", "same"), np.random.default_rng(0).uniform(1, 2, 8)
    before, after = np.stack([0 * draws, draws, draws]), np.stack([draws, 0 * draws, draws])
    found = Comparison("standard", "smooth", names, np.ones(3), before, after, None, None)  # pyright: ignore[reportArgumentType]
    (dots,) = report.held_out_figure([found]).data
    shown = dict(zip(dots.y, zip(dots.x, dots.error_x.array, dots.error_x.arrayminus, strict=True), strict=True))
    assert shown["worse"] == (report.MOST, 0, 0) and shown["better"] == (report.LEAST, 0, 0) and shown["same"] == (1, 0, 0)
    assert 0.5 < shown["objective"][0] < 2
