import json
import re
from html import unescape
from pathlib import Path

import pytest

from g1stream.extras.library.page import write_page
from g1stream.extras.library.table import MotionRow, Rows, writing

#: Sorts, filters and asks the page for what a reader sees.
PROBE = """<script>
const names = () => [...document.querySelectorAll("tbody tr")].map((row) =>
  row.children[heads().indexOf("name")].textContent);
const heads = () => [...document.querySelectorAll("thead th > button")].map((one) =>
  one.textContent.replace(/ [▼▲]/, ""));
const click = (name) =>
  document.querySelectorAll("thead th > button")[heads().indexOf(name)].click();
const filter = document.getElementById("filter");
const type = (text) => { filter.value = text; filter.dispatchEvent(new Event("input")); };
const seen = { heads: heads(), first: names(),
  pictures: document.querySelectorAll("td path").length,
  tooltips: [...document.querySelectorAll("tbody tr")].map((row) => row.children[1].title),
  reasons: [...document.querySelectorAll("td.reason")].map((one) => one.textContent),
  bars: document.querySelectorAll("th rect").length };
click("max speed"); seen.descending = names();
click("max speed"); seen.ascending = names();
type("max_speed>2 WAVE"); seen.filtered = names();
type("status=broken"); seen.broken = names();
type(""); document.querySelectorAll(".kinds button")[0].click(); seen.clicked = filter.value;
type(""); document.querySelector("th rect[height='26']").dispatchEvent(new Event("click"));
seen.bar = filter.value;
const told = document.createElement("pre");
told.id = "seen";
told.textContent = JSON.stringify(seen);
document.body.append(told);
</script></body>"""


@pytest.fixture
def library(tmp_path):
    """Three motions: one broken, one that cannot be played, one that can."""

    def row(name, **values):
        about = {"key": name, "path": f"{name}.csv", "sha256": name, "command": "check"}
        return Rows(motion=MotionRow(name=name, **about, **values))

    good = {"bolted": "yes", "free": "yes", "max_speed": 1.0, "picture": "M0 0L5 5"}
    bad = {"bolted": "yes", "free": "no", "max_speed": 3.0, "picture": "M0 0L5 5"}
    with writing(tmp_path) as writer:
        writer.add([row("stand <b>&amp;", **good), row("wave", **bad)])
        writer.add([row("gone", status="broken", reason="</script><script>alert(1)</script>")])
    return tmp_path


def table_of(page, command="check"):
    """Its columns, and its rows as dictionaries."""
    (data,) = re.findall(r'id="data">(.*)</script>\n<script>', page.read_text())
    table = json.loads(data)[command]
    names = [column["name"] for column in table["columns"]]
    return table["columns"], [dict(zip(names, row, strict=True)) for row in table["rows"]]


def test_the_worst_is_first_and_it_needs_no_network(library):
    page = write_page(library)
    assert "http" not in page.read_text().replace("http://www.w3.org/2000/svg", "")
    columns, rows = table_of(page)
    units = {column["name"]: column["unit"] for column in columns}
    assert [*units] == [
        *("picture", "name", "status", "reason"),
        *("bolted", "free", "max_speed", "path"),
    ]
    assert units["max_speed"] == "rad/s"
    found = [(row["name"], row["max_speed"]) for row in rows]
    assert found == [("gone", None), ("wave", 3.0), ("stand <b>&amp;", 1.0)]


def test_files_of_one_name_are_told_apart(tmp_path):
    paths = ["/motions/day1/a/wave.csv", "/motions/day2/a/wave.csv", "/motions/walk.csv"]
    with writing(tmp_path) as writer:
        for path in paths:
            about = {"key": path, "name": Path(path).stem, "path": path, "sha256": path}
            writer.add([Rows(motion=MotionRow(command="check", **about))])
    _, rows = table_of(write_page(tmp_path))
    assert {row["name"] for row in rows} == {"day1/a/wave.csv", "day2/a/wave.csv", "walk"}


def test_a_broken_file_has_the_reason_that_was_found_last(tmp_path):
    about = {"name": "gone", "path": "gone.csv", "sha256": "", "command": "simulate"}
    with writing(tmp_path) as writer:
        for variant, reason in (("bolted", "before"), ("free", "now")):
            about |= {"key": variant, "variant": variant, "status": "broken", "reason": reason}
            writer.add([Rows(motion=MotionRow(**about))])
        played = MotionRow(key="1", name="walk", path="walk.csv", sha256="1", command="simulate")
        writer.add([Rows(motion=played, sweep={"stream.rate": 500.0})])
    _, rows = table_of(write_page(tmp_path), "simulate")
    found = [(row["reason"], row["stream.rate"]) for row in rows]
    assert found == [("now", None), (None, 500.0)]


@pytest.mark.slow
def test_it_sorts_and_filters_in_a_browser(library, chromium):
    page = write_page(library)
    page.write_text(page.read_text().replace("</body>", PROBE))
    shown = chromium("--dump-dom", page.as_uri())
    seen = json.loads(unescape(re.search(r'<pre id="seen">(.+)</pre>', shown)[1]))
    assert seen["heads"][:4] == ["picture", "name", "status", "bolted"]
    assert seen["reasons"] == ["</script><script>alert(1)</script>"]
    assert seen["tooltips"] == ["gone.csv", "wave.csv", "stand <b>&amp;.csv"]
    assert seen["first"] == ["gone", "wave", "stand <b>&amp;"]
    assert seen["pictures"] == 2
    assert seen["bars"] == 14
    assert seen["descending"] == ["wave", "stand <b>&amp;", "gone"]
    assert seen["ascending"] == ["stand <b>&amp;", "wave", "gone"]
    assert seen["filtered"] == ["wave"]
    assert seen["broken"] == ["gone"]
    assert seen["clicked"] == 'status="ok"'
    assert seen["bar"] == "max_speed<1.143"
