"""HTML reports of sessions, and comparisons of sessions."""

from typing import TYPE_CHECKING

from g1stream.optional import lazily

if TYPE_CHECKING:
    from g1stream.extras.report.comparison import Comparison as Comparison
    from g1stream.extras.report.comparison import compare as compare
    from g1stream.extras.report.page import report as report

__all__ = ["Comparison", "compare", "report"]

__getattr__ = lazily(
    __name__, {"Comparison": "comparison", "compare": "comparison", "report": "page"}
)
