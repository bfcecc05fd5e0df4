"""The page in a real browser: its figures draw, the joint can be chosen, it prints on A4."""

import json
import re
import shutil
import subprocess

import numpy as np
import pytest

import g1stream

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed"),
]

#: Asks the page for what a reader sees, once it is drawn.
PROBE = """<script>
const wait = setInterval(() => {
  if (!document.documentElement.dataset.drawn) return;
  clearInterval(wait);
  const plot = document.querySelector("[data-figure=joint]");
  const lines = () => plot.data.map((one) => [one.name, one.yaxis, Math.max(...one.y)]);
  const before = lines();
  const select = document.querySelector("select");
  select.value = "3";
  select.dispatchEvent(new Event("change"));
  const seen = {
    before, after: lines(), wide: document.documentElement.scrollWidth - innerWidth,
    figures: [...document.querySelectorAll("[data-figure]")].map((one) => [
      one.dataset.figure, one.querySelectorAll("path.js-line, .bars path").length,
      [...one.querySelectorAll(".xtitle, .ytitle, .y2title, .y3title")].map((t) => t.textContent),
    ]),
  };
  const told = document.createElement("pre");
  told.id = "seen";
  told.textContent = JSON.stringify(seen);
  document.body.append(told);
}, 20);
</script></body>"""


def chromium(tmp_path, *arguments):
    profile = f"--user-data-dir={tmp_path / 'profile'}"
    quiet = "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000", profile
    return subprocess.run(
        [CHROMIUM, *quiet, "--enable-logging=stderr", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=170,
        check=True,
    )


@pytest.fixture
def path(play, write_session):
    histogram = {"lateness_histogram_us": {"80": 900, "90": 100}}
    return write_session(*play(0.04, 0.1), {"stream": histogram})


def test_its_figures_draw_and_the_joint_can_be_chosen(path, tmp_path):
    page = g1stream.report(path, tmp_path / "report.html")
    page.write_text(page.read_text().replace("</body>", PROBE))
    done = chromium(tmp_path, "--window-size=390,844", "--dump-dom", page.as_uri())
    assert "CONSOLE" not in done.stderr
    seen = json.loads(re.search(r'<pre id="seen">([^<]+)<', done.stdout)[1])
    assert seen["wide"] <= 0
    drawn = {name: (marks, titles) for name, marks, titles in seen["figures"]}
    assert set(drawn) == {"limbs", "joint", "rmse_deg", "lateness", "intervals"}
    for marks, titles in drawn.values():
        assert marks >= 1
        assert len(titles) >= 2
        assert all(titles)
    session = g1stream.open_session(path)
    first = session.tracking().rmse.argmax()
    for told, joint in ((seen["before"], first), (seen["after"], 3)):
        measured = next(top for name, axis, top in told if name == "measured")
        assert measured == pytest.approx(np.degrees(session.measured.q[:, joint].max()), rel=1e-6)
    assert {axis for _, axis, _ in seen["after"]} == {"y", "y2", "y3"}


def test_it_prints_on_a4(path, tmp_path):
    page, pdf = g1stream.report(path, tmp_path / "report.html"), tmp_path / "report.pdf"
    chromium(tmp_path, f"--print-to-pdf={pdf}", "--no-pdf-header-footer", page.as_uri())
    boxes = re.findall(rb"/MediaBox \[([\d. ]+)\]", pdf.read_bytes())
    assert boxes
    for box in boxes:
        left, bottom, right, top = map(float, box.split())
        assert (right - left, top - bottom) == pytest.approx((595.3, 841.9), abs=1.0)
