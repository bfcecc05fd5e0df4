import json
import re

import numpy as np
import pytest

import g1stream

pytestmark = pytest.mark.slow

#: Asks the page for what a reader sees, once it is drawn, and tells the page around it.
PROBE = """<script>
const wait = setInterval(() => {
  if (!document.documentElement.dataset.drawn) return;
  clearInterval(wait);
  const select = document.querySelector("select"), before = select.value;
  const plot = select.closest("figure").querySelector("[data-figure]");
  const lines = () => plot.data.map((one) => [one.name, one.yaxis, Math.max(...one.y)]);
  const joint = (name) => {
    select.value = name;
    select.dispatchEvent(new Event("change"));
    return lines();
  };
  parent.postMessage({
    legends: plot.querySelectorAll(".legend, .legend2, .legend3").length, height: plot.clientHeight,
    first: Number(before), before: lines(), after: joint("3"), width: innerWidth,
    wide: document.documentElement.scrollWidth - innerWidth,
    figures: [...document.querySelectorAll("[data-figure]")].map((one) => [
      one.dataset.figure, one.querySelectorAll("path.js-line, .bars path").length,
      [...one.querySelectorAll(".xtitle, .ytitle, .y2title, .y3title")].map((t) => t.textContent),
    ]),
  }, "*");
}, 20);
</script></body>"""
#: The window of a browser without a screen cannot be as narrow as a phone; a frame in it can.
PHONE = """<body><iframe src="{}" style="width:390px;height:844px;border:0"></iframe><script>
addEventListener("message", ({{ data }}) => {{
  const told = document.createElement("pre");
  told.id = "seen";
  told.textContent = JSON.stringify(data);
  document.body.append(told);
}});
</script></body>"""


@pytest.fixture
def path(play, write_session):
    histogram = {"lateness_histogram_us": {"80": 900, "90": 100}}
    return write_session(*play(0.04, 0.1), {"stream": histogram})


@pytest.fixture
def seen_on_a_phone(chromium, tmp_path):
    def see(page):
        page.write_text(page.read_text().replace("</body>", PROBE))
        around = tmp_path / "phone.html"
        around.write_text(PHONE.format(page.as_uri()))
        shown = chromium("--dump-dom", around.as_uri())
        seen = json.loads(re.search(r'<pre id="seen">([^<]+)<', shown)[1])
        assert seen["width"] == 390
        assert seen["wide"] <= 0
        for _, marks, titles in seen["figures"]:
            assert marks >= 1
            assert len(titles) >= 2
            assert all(titles)
        return seen

    return see


def test_its_figures_draw_and_the_joint_can_be_chosen(seen_on_a_phone, path, tmp_path):
    seen = seen_on_a_phone(g1stream.report.report(path, tmp_path / "report.html"))
    drawn = {one[0] for one in seen["figures"]}
    assert drawn == {"limbs", "joint", "rmse_deg", "lateness", "intervals"}
    session = g1stream.open_session(path)
    assert seen["first"] == session.tracking().rmse.argmax()
    for told, joint in ((seen["before"], seen["first"]), (seen["after"], 3)):
        measured = next(top for name, axis, top in told if name == "measured")
        assert measured == pytest.approx(np.degrees(session.measured.q[:, joint].max()), rel=1e-6)
    assert {axis for _, axis, _ in seen["after"]} == {"y", "y2", "y3"}
    assert seen["legends"] == 3


def test_a_converted_motion_has_no_room_for_what_it_lacks(seen_on_a_phone, tmp_path):
    g1stream.convert("demo", tmp_path / "motion.mcap")
    page = g1stream.report.report(tmp_path / "motion.mcap", tmp_path / "report.html")
    seen = seen_on_a_phone(page)
    ((name, _, titles),) = seen["figures"]
    assert name == "joint"
    assert titles == ["time, s", "position, deg"]
    assert seen["height"] < 400


def test_it_prints_on_a4(chromium, path, tmp_path):
    page, pdf = tmp_path / "page.html", tmp_path / "page.pdf"
    g1stream.report.report(path, page)
    chromium(f"--print-to-pdf={pdf}", "--no-pdf-header-footer", page.as_uri())
    boxes = re.findall(rb"/MediaBox \[([\d. ]+)\]", pdf.read_bytes())
    assert boxes
    for box in boxes:
        left, bottom, right, top = map(float, box.split())
        assert (right - left, top - bottom) == pytest.approx((595.3, 841.9), abs=1.0)
