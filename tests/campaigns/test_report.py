"""Pages as a reader meets them: opened in a real browser, with the numbers of the JSON beside them."""

import math
import re
import shutil
from pathlib import Path

import hypothesis.extra.numpy as arrays
import jax
import numpy as np
import plotly.graph_objects as go
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxftc
from jaxftc.paper import diagram
from jaxftc.paper import experiment as paper
from jaxftc.paper.page import demo_page
from jaxftc.report import campaign, figures
from jaxftc.report.figures import MOST, thin, trace_page, windows
from jaxftc.report.page import embed, notes, page, table

pytestmark = pytest.mark.thorough  # they are drawn in a browser

SCREENS = {"desktop": (1200, 900), "phone": (390, 844)}


@pytest.fixture(scope="module")
def config(paper_arm):
    return jaxftc.Config(paper_arm, engine="chain", duration=0.3)


@pytest.fixture(scope="module")
def experiment(config):
    """The demo's experiment, on the quick engine and for part of the motion."""
    with jax.enable_x64(False):
        return paper.run(config, jaxftc.default_gains(config), jax.random.key(0))


@pytest.fixture(scope="module")
def report(config, experiment, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(demo_page(config, jaxftc.default_gains(config), experiment), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def browser():
    drive = pytest.importorskip("playwright.sync_api", reason="needs the package playwright")
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        pytest.skip("needs a Chromium on the PATH")
    with drive.sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        yield chromium
        chromium.close()


def opened(browser, path, screen="desktop"):
    """The page once all is drawn, and what the browser complained about."""
    width, height = SCREENS[screen]
    tab = browser.new_page(viewport={"width": width, "height": height}, has_touch=screen == "phone", offline=True)
    complaints = []
    tab.on("console", lambda message: complaints.append(message.text) if message.type in ("error", "warning") else None)
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.goto(path.as_uri())
    tab.wait_for_function("document.documentElement.dataset.drawn")
    return tab, complaints


@pytest.mark.parametrize("screen", SCREENS)
def test_every_figure_of_the_paper_is_drawn(browser, report, screen):
    tab, complaints = opened(browser, report, screen)
    assert complaints == []
    anchors = {
        f"figure-{n}" for n in ("2", "3", "4", "5", "6", "7", "8", "9", "10", "11", "12", "13", "14", "15", "15b", "16")
    }
    there = set(tab.evaluate("[...document.querySelectorAll('[id]')].map((e) => e.id)"))
    assert anchors | {"table-1"} <= there
    canvases = tab.locator(".canvas")
    assert canvases.count() == int(tab.evaluate("document.documentElement.dataset.drawn")) == 16
    for canvas in canvases.all():
        lines = canvas.evaluate("(c) => c.querySelectorAll('.scatterlayer path.js-line, .heatmaplayer image').length")
        shown = canvas.evaluate("(c) => c.data.filter((t) => t.visible).length")
        assert lines >= 1 and shown >= 1
    assert tab.evaluate("document.documentElement.scrollWidth") <= SCREENS[screen][0], (
        "the page itself never scrolls sideways"
    )
    tab.close()


def test_the_reader_chooses_the_joint(browser, report):
    tab, complaints = opened(browser, report)
    joints = "(c) => [...new Set(c.data.filter((t) => t.visible && t.meta).map((t) => t.meta.joint))].sort()"
    together, single = tab.locator("#figure-12 .canvas"), tab.locator("#figure-3 .canvas")
    assert together.evaluate(joints) == [0, 1, 2, 3, 4, 5] and single.evaluate(joints) == [0]
    tab.check(".joints input[value='3']")
    for canvas in tab.locator(".canvas").all():
        assert set(canvas.evaluate(joints)) <= {3}
    assert together.evaluate(joints) == single.evaluate(joints) == [3]
    tab.check(".joints input[value='all']")
    assert together.evaluate(joints) == [0, 1, 2, 3, 4, 5] and single.evaluate(joints) == [0]
    assert complaints == []
    tab.close()


def test_numbers_on_the_page_are_those_of_the_json(browser, report, experiment):
    tab, _ = opened(browser, report)
    result = paper.as_json(experiment)
    shown = [row.split("\t") for row in tab.locator("table.claims tbody tr").all_inner_texts()]
    assert [(cells[0], cells[1], cells[3]) for cells in shown] == [
        ("met" if c["met"] else "not met", f"Fig. {c['figure']}", f"{c['value']:.4g} {c['unit']}") for c in result["claims"]
    ]
    for claim in result["claims"]:
        under = " ".join(tab.locator(f"#figure-{claim['figure']} .claim").all_inner_texts())
        assert f"{claim['claim']}: {claim['value']:.4g} {claim['unit']}" in under
    rows = [row.split("\t") for row in tab.locator("table").last.locator("tbody tr").all_inner_texts()]
    assert len(rows) == len(result["rows"]) == 4 * 3 * 3
    for cells, row in zip(rows, result["rows"], strict=True):
        assert cells[:3] == [row["condition"], row["observer"].upper(), row["controller"].upper()]
        assert cells[3:5] == [f"{row['fault_tau_rms_nm']:.3f}", f"{row['fault_q_rms_deg']:.4f}"]
        assert cells[8:] == [f"{row['tracking_rms_deg']:.3f}", f"{row['chattering']:.2f}"]
    tab.close()


def test_curves_are_the_traces(browser, report, experiment):
    """What plotly holds after the trip through the page, against the run itself."""
    tab, _ = opened(browser, report)
    run = experiment.traces[paper.LAST][1]  # actuator
    held = tab.locator("#figure-12 .canvas").evaluate("(c) => c._fullData.map((t) => [t.name, t.meta.joint, [...t.y]])")
    for joint in range(6):
        torque, angle, _ = (y for name, j, y in held if j == joint and name == f"joint{joint + 1}")
        np.testing.assert_allclose(torque, run["statistic_tau"][:, joint], rtol=1e-6)
        np.testing.assert_allclose(angle, np.rad2deg(run["statistic_q"][:, joint]), rtol=1e-5, atol=1e-9)
        levels = [y[0] for name, j, y in held if j == joint and name == "threshold"]
        assert np.allclose(levels, [2.0, -2.0, 1.0, -1.0])
    ((start, end),) = tab.locator("#figure-12 .canvas").evaluate("(c) => [[c.layout.shapes[0].x0, c.layout.shapes[0].x1]]")
    assert np.allclose((start, end), (0.1, 0.25), atol=2e-3)
    tab.close()


def test_every_claim_has_its_figure(experiment):
    ids = [claim.id for claim in experiment.claims]
    assert len(ids) == len(set(ids))
    assert {claim.figure for claim in experiment.claims} >= {
        "2",
        "3",
        "4",
        "6",
        "7",
        "10",
        "11",
        "12",
        "13",
        "14",
        "15b",
        "16",
    }
    named = {claim.id: claim for claim in experiment.claims}
    assert named["threshold_small"].met and named["threshold_large"].met and named["healthy_residuals"].met
    assert named["first_joint_ts"].met, "each observer has runs of its own, and the last is the best"


def test_the_page_needs_nothing_from_elsewhere(report):
    text = report.read_text(encoding="utf-8")
    outside = re.sub(r"<script>.*?</script>", "", text, count=1, flags=re.DOTALL)  # plotly itself
    assert not re.search(r"(src|href)=.(?!#|data:)", outside)
    assert len(text) < 8e6


def test_a_page_of_one_joint_offers_no_choice(tmp_path):
    assert "<fieldset" not in page("one", ["<p>text</p>"], ["joint1"]) and "<fieldset" in page("two", [], ["a", "b"])


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ({"joint_tau": 2, "magnitude": 0.31, "unit": "1"}, "Fault of the actuator of joint 2, 0.31, from"),
        ({"joint_q": 1, "magnitude": 1.0, "unit": "1"}, "Fault of the encoder of joint 1, 1, from"),
        ({"joint_tau": 1, "magnitude": 5.0, "unit": "N m"}, "Fault of the actuator of joint 1, 5 N m, from"),
        ({"link": 3, "magnitude": 55.0, "unit": "N"}, "Contact at link 3, 55 N, from"),
    ],
)
def test_the_fate_of_a_run_says_what_was_wrong(row, said):
    rest = {"diverged": False, "delay_s": math.inf, "joint_tau": 0, "joint_q": 0, "onset_s": 0.1, "false_alarm": False}
    assert campaign._fate(rest | row) == f"{said} 0.100 s: missed"


def test_what_a_user_wrote_is_text():
    line = figures.finish(go.Figure(go.Scatter(y=[1.0], name="</script><b>")), "<i>title</i>", "a & b")
    text = embed(line)
    assert "<i>" not in text and "a &amp; b" in text and text.count("</script>") == 1
    assert table(("<x>",), [("<y>",)]).count("<x>") == 0


@given(arrays.arrays(np.float32, st.integers(1, 3 * MOST), elements=st.floats(-1e6, 1e6, width=32)))
def test_thinning_keeps_the_extremes_in_order(y):
    kept, step = thin(y)
    assert len(kept) <= MOST and kept.min() == y.min() and kept.max() == y.max()
    assert abs(len(kept) * step - len(y)) <= 2 * step
    if len(y) <= MOST:
        assert kept is y


def test_fault_windows_are_where_the_fault_is():
    there = np.array([0, 1, 1, 0, 0, 1, 0])[:, None] * np.ones((1, 2))
    trace = {"t": 0.1 * np.arange(7), "fault_tau": there, "fault_q": 0 * there, "contact_tau": 0 * there}
    np.testing.assert_allclose(list(windows(trace)), [(0.1, 0.2), (0.5, 0.5)])


def test_a_scheme_without_a_threshold_draws_none(config, experiment):
    run = experiment.traces[paper.LAST][0]
    blind = run | {"threshold_q": np.full_like(run["threshold_q"], np.inf)}
    names = [[trace.name for trace in figures.residual_figure(config, one, "").data] for one in (run, blind)]
    assert names[0].count("threshold") == 24 and names[1].count("threshold") == 12


def test_the_page_of_one_run(browser, config, experiment, tmp_path):
    path = tmp_path / "figures.html"
    path.write_text(trace_page(config, experiment.traces[paper.LAST][3], "both: T-S, AFESMC"), encoding="utf-8")
    tab, complaints = opened(browser, path)
    assert complaints == [] and tab.locator(".canvas").count() == 2
    tab.close()


def test_boxes_of_the_diagram_are_files():
    package = Path(jaxftc.__file__).parent
    assert all((package / box.module).is_file() for box in diagram.BOXES.values())
    assert {box.block for box in diagram.BOXES.values()} >= set("123456789")
    assert diagram.draw().count("<rect") == len(diagram.BOXES)


def test_what_a_log_says_stays_text():
    """Notes name columns of a file that somebody else wrote."""
    assert notes(["column <script>"]) == "<p class='note'>column &lt;script&gt;</p>"
