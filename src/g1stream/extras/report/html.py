"""HTML pages that need no network, from the templates in this directory."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Container, Mapping, Sequence
from datetime import datetime, timezone
from importlib import resources
from typing import Any

from g1stream._version import __version__
from g1stream.optional import import_extra
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES
from g1stream.text import printable, short_name


def render_page(template: str, drawn: Sequence[Mapping[str, Any]], **values: Any) -> str:
    """Render a page with the script that draws its figures.

    Text is escaped, including terminal control characters, because it may come from a file or peer.
    """
    jinja = import_extra("jinja2", "report", "A report needs")
    plotly = import_extra("plotly.offline", "report", "A report needs")

    environment = jinja.Environment(
        loader=jinja.PackageLoader("g1stream.extras.report", "."),
        autoescape=True,
        undefined=jinja.StrictUndefined,
        trim_blocks=True,
        finalize=lambda value: printable(value) if type(value) is str else value,
    )
    text: str = environment.get_template(template).render(
        values,
        made=f"g1stream {__version__}, {datetime.now(timezone.utc):%Y-%m-%d %H:%M} UTC",
        style=_resource(jinja, "report.css"),
        script=_resource(jinja, "report.js"),
        plotly=_packed(plotly.get_plotlyjs()),
        figures=_packed(json.dumps(drawn)),
    )
    return text


def joints_by_limb(shown: Container[str]) -> dict[str, dict[int, str]]:
    """The joints in `shown` by limb and motor index, with readable names."""
    limbs = {
        limb.replace("_", " "): {
            j: short_name(JOINT_NAMES[j]) for j in joints if JOINT_NAMES[j] in shown
        }
        for limb, joints in JOINT_GROUPS.items()
    }
    return {limb: joints for limb, joints in limbs.items() if joints}


def _packed(text: str) -> str:
    return base64.b64encode(gzip.compress(text.encode(), 6, mtime=0)).decode()


def _resource(jinja: Any, name: str) -> Any:
    """A file of this directory, inserted without escaping."""
    text = resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
    return jinja.utils.markupsafe.Markup(text)
