"""The page of a report: its sections, and with them the script that draws the figures."""

from __future__ import annotations

import base64
import csv
import io
import os
from functools import partial
from mimetypes import guess_type
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final, cast

from g1stream.analysis.summarise import flat
from g1stream.analysis.summary import outcome, session_facts, stream_facts
from g1stream.app.session import Session, open_session
from g1stream.errors import ConfigError, RecordingError
from g1stream.extras.report import html
from g1stream.extras.report.figures import figures
from g1stream.extras.report.physics import physics_section, session_physics
from g1stream.extras.report.tables import overview, tables
from g1stream.files import check_not_input, check_suffix, complete_file, read_file
from g1stream.optional import extension
from g1stream.robot.joints import JOINT_NAMES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from typing import TypeAlias

    from g1stream.analysis.metrics import Metrics
    from g1stream.analysis.summary import Summary
    from g1stream.extras.physics.result import MotionPhysics

    Given: TypeAlias = Session | str | os.PathLike[str]
    Progress: TypeAlias = Callable[[str, float], None]

__all__ = ["numbers", "report", "to_csv"]

#: A video or picture beside a session, of the same name, is shown; the first of these.
_PICTURES: Final = (".mp4", ".gif", ".png")
_LARGEST_PICTURE: Final = 50 * 2**20


def report(
    sessions: Given | Iterable[Given],
    path: str | os.PathLike[str],
    *,
    video: bool = False,
    force: bool = False,
    progress: Progress = lambda what, fraction: None,
) -> Path:
    """Write the report of one session or several: an HTML page that needs no network.

    A video or a picture beside a session file, of the same name, is shown in it.

    Args:
        sessions: sessions, or their paths.
        path: of the page.
        video: render each session for the page, see `Session.render`; needs the extra `video`.
        force: replace a file that is there.
        progress: called with what takes its time, and the fraction of it that is done, 0 to 1.

    Raises:
        ConfigError: there are no sessions, the path does not end in .html, or a package for the
            video is not installed.
        RecordingError: a session is damaged, or the page cannot be written.
        SimError: there is no OpenGL to draw the video with.
    """
    check_suffix(Path(path), "a page", ".html")
    opened = _opened(sessions, Path(path))
    with complete_file(Path(path), force=force) as temporary:
        page = _page(opened, _rendered if video else _beside, progress)
        temporary.write_text(page, encoding="utf-8")
    return Path(path)


def numbers(
    sessions: Given | Iterable[Given], progress: Progress = lambda what, fraction: None
) -> dict[str, Any]:
    """The numbers of a report as values for JSON: summary, metrics and physics of each session."""
    found = []
    for session in _opened(sessions):
        metrics, summary = session.metrics(), session.summary()
        physics = session_physics(session, summary, partial(progress, "physics"))
        found.append(_values(session, metrics, summary, physics))
    return {"sessions": found}


def to_csv(sessions: Given | Iterable[Given]) -> str:
    """The metrics of sessions as CSV: a row for each, by session and key."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("session", "key", "value"))
    for session in _opened(sessions):
        values = flat(session.metrics().model_dump(mode="json"))
        rows.writerows((session.path, key, v) for key, v in values.items() if v is not None)
    return text.getvalue()


def _opened(sessions: Given | Iterable[Given], page: Path | None = None) -> Iterator[Session]:
    """The sessions, all of which can be opened; none is `page`.

    Each is let go after its turn, so that the samples of no more than one have to be in memory.
    """
    alone = isinstance(sessions, (Session, str, os.PathLike))
    given = cast("Iterable[Given]", [sessions] if alone else sessions)
    opened = [one if isinstance(one, Session) else open_session(one) for one in given]
    if not opened:
        raise ConfigError("There is no session to report on.", "Name a session file.")
    if page:
        check_not_input(page, *(session.path for session in opened))
    return (opened.pop(0) for _ in range(len(opened)))


def _values(
    session: Session, metrics: Metrics, summary: Summary, physics: MotionPhysics | str
) -> dict[str, Any]:
    return {
        "path": str(session.path),
        "verdict": outcome(summary),
        "summary": summary.model_dump(mode="json"),
        "metrics": metrics.model_dump(mode="json"),
        "physics": None if isinstance(physics, str) else physics.model_dump(mode="json"),
    }


def _page(
    sessions: Iterable[Session],
    picture: Callable[[Session, Callable[[float], None]], str],
    progress: Progress,
) -> str:
    values, sections, drawn = [], [], []
    for number, session in enumerate(sessions):
        # The metrics read all columns that are needed, the summary alone only some.
        metrics, summary = session.metrics(), session.summary()
        physics = session_physics(session, summary, partial(progress, "physics"))
        values.append(_values(session, metrics, summary, physics))
        drawn.append(figures(session, summary, metrics))
        support = summary.stream.support if summary.stream else None
        parts = {
            "picture": picture(session, partial(progress, "video")),
            "physics": physics_section(physics, support, f"sessions.{number}.physics"),
        }
        shown = values[-1]["metrics"], drawn[-1]
        sections.append(_section(number, session, summary, *shown, parts))
    one = len(values) == 1
    title = Path(values[0]["path"]).name if one else f"{len(values)} sessions"
    return html.page(
        f"{title}: report",
        f"Report of {title}",
        "\n".join(sections),
        drawn,
        overview="" if one else overview(values),
    )


def _section(
    number: int,
    session: Session,
    summary: Summary,
    metrics: Mapping[str, Any],
    drawn: Mapping[str, Any],
    more: Mapping[str, str],
) -> str:
    parts = tables(metrics, f"sessions.{number}.metrics")
    for name in ("joints", "torques"):
        parts[name] = html.details("Each joint", parts[name])
    for name in ("tracking", "body", "torque"):
        parts[f"missing_{name}"] = html.missing(metrics["missing"].get(name))
    support = summary.stream.support if summary.stream else None
    if metrics["body"] and support in {"bolted", "hanging"}:
        parts["missing_body"] += html.missing(
            f"The pelvis was held ({support}): only the figures of the joints alone, and of hands "
            "and feet, tell how closely the robot followed."
        )
    parts["missing_timing"] = html.missing(None if parts["topics"] else "No topic of DDS.")
    if any(one["lines"] for one in drawn["signals"].values()):
        choice = html.joint_choice(drawn["first_joint"], {*JOINT_NAMES} - {*summary.absent})
        parts["joint"] = html.figure("joint", f"Joint {choice}", number)
    for name, caption in (
        ("limbs", "RMS error of each limb over time, and events of the log; PLAY is not shaded"),
        ("rmse_deg", "RMSE of each joint; a click shows it above"),
        ("lateness", "How late commands were written"),
        ("intervals", "Intervals between publish times: a stall is a peak"),
    ):
        parts[f"{name}_figure"] = html.figure(name, caption, number) if drawn[name] else ""
    facts = session_facts(summary)
    if summary.versions:
        facts.append(("versions", ", ".join(map(" ".join, summary.versions.items()))))
    return html.template("session.html").substitute(
        {"joint": "", **parts, **more},
        number=number,
        name=html.escaped(session.path.name),
        verdict=html.escaped(outcome(summary)),
        good="bad" if summary.problems else "good" if summary.tracking else "",
        problems="".join(
            f'<p class="problem">{html.escaped(text)}</p>' for text in summary.problems
        ),
        facts=html.facts(facts),
        stream=html.facts(stream_facts(summary.stream) if summary.stream else []),
        events=_events(drawn["events"]),
    )


def _events(events: Sequence[Mapping[str, Any]]) -> str:
    if not events:
        return html.missing("The log has no events.")
    rows = [(f"{one['time']:.3f}", one["level"], one["text"]) for one in events]
    table = html.text_table(("time, s", "level", "event"), rows)
    return html.details(f"{len(events)} in the log", table)


def _beside(session: Session, _: Callable[[float], None]) -> str:
    """The video or picture beside a session file; none beside a session in memory."""
    paths = [session.path.with_suffix(suffix) for suffix in _PICTURES] if session.paths else []
    path = next(filter(Path.is_file, paths), None)
    return _picture(path) if path else ""


def _rendered(session: Session, progress: Callable[[float], None]) -> str:
    """A video of the session, if there is something in it to show."""
    with TemporaryDirectory() as directory:
        path = Path(directory) / "session.mp4"
        try:
            extension("render")(session, path, progress=progress)
        except RecordingError as error:
            return html.missing(error.cause)
        return _picture(path)


def _picture(path: Path) -> str:
    try:
        data = base64.b64encode(read_file(path, _LARGEST_PICTURE)).decode()
    except OSError as error:
        return html.missing(f"{path.name} is not shown: {error.strerror}.")
    kind = guess_type(path.name)[0] or ""
    if kind.startswith("video/"):
        return f'<video controls muted loop playsinline src="data:{kind};base64,{data}"></video>'
    return (
        f'<img class="picture" alt="the robot and its reference" src="data:{kind};base64,{data}">'
    )
