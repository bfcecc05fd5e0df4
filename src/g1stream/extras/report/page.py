"""The report of sessions, as an HTML page, JSON or CSV."""

from __future__ import annotations

import base64
import csv
import gzip
import io
import json
import os
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from datetime import datetime, timezone
from functools import partial
from importlib import resources
from mimetypes import guess_type
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias, cast

from g1stream._version import __version__
from g1stream.analysis.metrics import Metrics
from g1stream.analysis.summarise import flat, played
from g1stream.analysis.summary import Summary, outcome, session_facts, stream_facts
from g1stream.app.session import Session, open_session
from g1stream.errors import ConfigError, MotionError, RecordingError, RobotError
from g1stream.extras.physics.measure import motion_physics
from g1stream.extras.physics.result import MotionPhysics, Verdict
from g1stream.extras.policy.steps import PolicySteps, policy_steps
from g1stream.extras.report.cause import WorstError, worst_error
from g1stream.extras.report.figures import figures
from g1stream.extras.report.tables import overview, physics_tables, policy_tables, tables
from g1stream.files import check_not_input, check_suffix, complete_file, read_file
from g1stream.motion.limits import Interval
from g1stream.motion.readers import MotionFile
from g1stream.optional import import_extra
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES
from g1stream.session.records import MotionInfo, read_record
from g1stream.text import counted, printable, short_name

if TYPE_CHECKING:
    from g1stream.motion.motion import Motion
    from g1stream.session.recording import Recording
    from g1stream.types import StreamSupport

    Given: TypeAlias = Session | str | os.PathLike[str]
    Progress: TypeAlias = Callable[[str, float], None]

__all__ = ["numbers", "report"]

#: Suffixes of the video or picture beside a session with its name; the first found is shown.
_PICTURES: Final = (".mp4", ".gif", ".png")
_LARGEST_PICTURE: Final = 50 * 2**20
#: Number of joints at their torque limits that are listed.
_MOST_SATURATED: Final = 5
#: Rate at which the reference is sampled if no motion is attached, Hz.
_FPS: Final = 30.0
#: Most frames for the physics; more would take seconds.
_MOST_FRAMES: Final = 10_000


def report(
    sessions: Given | Iterable[Given],
    path: str | os.PathLike[str],
    *,
    force: bool = False,
    progress: Progress = lambda what, fraction: None,
) -> Path:
    """Write the report of one session or several: an HTML page that needs no network.

    A video or a picture beside a session file, of the same name, is shown in it.

    Args:
        sessions: sessions, or their paths.
        path: path of the page.
        force: replace an existing file.
        progress: called with a label and the fraction done, 0 to 1.

    Raises:
        ConfigError: there are no sessions, or the path does not end in .html.
        RecordingError: a session is damaged, or the page cannot be written.
    """
    check_suffix(Path(path), "a page", ".html")
    opened = _opened(sessions, Path(path))
    with complete_file(Path(path), force=force) as temporary:
        temporary.write_text(_page(opened, progress), encoding="utf-8")
    return Path(path)


def numbers(
    sessions: Given | Iterable[Given], progress: Progress = lambda what, fraction: None
) -> dict[str, Any]:
    """The report as JSON values: summary, metrics, physics and policy of each session."""
    return {"sessions": [_told(session, progress)[-1] for session in _opened(sessions)]}


def to_csv(sessions: Given | Iterable[Given]) -> str:
    """The metrics of sessions as CSV, a row for each session and key."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("session", "key", "value"))
    for session in _opened(sessions):
        values = flat(session.metrics().model_dump(mode="json"))
        rows.writerows((session.path, key, v) for key, v in values.items() if v is not None)
    return text.getvalue()


def _opened(sessions: Given | Iterable[Given], page: Path | None = None) -> Iterator[Session]:
    """Open the sessions, after checking that all can be opened and none is `page`.

    Each session is released after its turn, so that only one is in memory.
    """
    alone = isinstance(sessions, (Session, str, os.PathLike))
    given = cast("Iterable[Given]", [sessions] if alone else sessions)
    opened = [one if isinstance(one, Session) else open_session(one) for one in given]
    if not opened:
        raise ConfigError("There is no session to report on.", "Give a session file.")
    if page:
        check_not_input(page, *(session.path for session in opened))
    return (opened.pop(0) for _ in range(len(opened)))


def _told(
    session: Session, progress: Progress
) -> tuple[Metrics, Summary, MotionPhysics | str, PolicySteps | None, dict[str, Any]]:
    """The content of a session's report, and the same as JSON values."""
    # The metrics read all columns that are needed; the summary needs only some of them.
    metrics, summary = session.metrics(), session.summary()
    physics = session_physics(session, summary, partial(progress, "physics"))
    policy = policy_steps(session)
    worst = worst_error(session) if summary.tracking else None
    values = {
        "path": str(session.path),
        "verdict": outcome(summary),
        "summary": summary.model_dump(mode="json"),
        "worst": worst.model_dump(mode="json") if worst else None,
        "metrics": metrics.model_dump(mode="json"),
        "physics": None if isinstance(physics, str) else physics.model_dump(mode="json"),
        "policy": policy.model_dump(mode="json") if policy else None,
    }
    return metrics, summary, physics, policy, values


def _page(sessions: Iterable[Session], progress: Progress) -> str:
    values, sections, drawn = [], [], []
    for number, session in enumerate(sessions):
        metrics, summary, physics, policy, told = _told(session, progress)
        values.append(told)
        drawn.append(figures(session, summary, metrics))
        key = f"sessions.{number}"
        file = session.path.name if session.paths else ""
        section = _section(key, told["metrics"], drawn[-1], summary, physics, file)
        if told["worst"]:
            section["facts"].append(("worst error", str(WorstError(**told["worst"]))))
        section["policy"] = _policy(policy, f"{key}.policy")
        sections.append({**section, "name": session.path.name, "picture": _picture(session)})
    one = len(values) == 1
    title = Path(values[0]["path"]).name if one else f"{len(values)} sessions"
    return _rendered(
        drawn,
        title=f"{title}: report",
        heading=f"Report of {title}",
        overview=None if one else overview(values),
        sessions=sections,
    )


def _section(
    key: str,
    metrics: Mapping[str, Any],
    drawn: Mapping[str, Any],
    summary: Summary,
    physics: MotionPhysics | str,
    session: str,
) -> dict[str, Any]:
    """A session's section for the template."""
    support = summary.stream.support if summary.stream else None
    held = bool(summary.held and metrics["body"])
    about_held = (
        f"The pelvis was held ({summary.held}), so its own errors and those in the world are "
        "omitted."
    )
    facts = session_facts(summary)
    if summary.versions:
        facts.append(("versions", ", ".join(map(" ".join, summary.versions.items()))))
    has_signals = any(one["lines"] for one in drawn["signals"].values())
    events = [(f"{one['time']:.3f}", one["level"], one["text"]) for one in drawn["events"]]
    return {
        **tables(metrics, f"{key}.metrics", held=held),
        "verdict": outcome(summary),
        "good": "bad" if summary.problems else "good" if summary.tracking else "",
        "problems": summary.problems,
        "missing": {name: metrics["missing"].get(name) for name in ("tracking", "body", "torque")},
        "held": about_held if held else "",
        "choice": _joints_by_limb({*JOINT_NAMES} - {*summary.absent}) if has_signals else None,
        "facts": facts,
        "stream": stream_facts(summary.stream) if summary.stream else [],
        "events": events,
        "drawn": drawn,
        "physics": _physics(physics, support, f"{key}.physics", session),
    }


def _physics(
    physics: MotionPhysics | str, support: StreamSupport | None, key: str, session: str
) -> dict[str, Any]:
    """The physics for the template, for the support of the session or for all supports."""
    if isinstance(physics, str):
        names = "facts", "excesses", "feet", "peaks", "collided", "collisions", "rest"
        return {"missing": physics, **dict.fromkeys(names)}
    shown = [support] if support else [*physics.verdicts]
    facts = [("frames", physics.played)]
    for one in shown:
        verdict = physics.verdicts[one]
        facts.append((one, str(verdict) if support in {None, "feet"} else _asked(verdict)))
    if shown != ["bolted"]:
        facts.append(("tilt", physics.tilt))
    on_feet = bool({"free", "feet"} & {*shown})
    if on_feet and physics.pressure:
        facts.append(("centre of pressure", physics.pressure))
    found = physics_tables(physics, shown, key)
    rest = f"The other supports: g1stream physics {session}"
    return {
        "missing": None,
        "facts": facts,
        **found,
        "feet": found["feet"] if on_feet else None,
        "rest": rest if support and session else None,
    }


def _asked(verdict: Verdict) -> str:
    """Whether a played motion exceeded the robot's limits."""
    beyond = ", ".join(dict.fromkeys(excess.cause for excess in verdict.excesses))
    return f"beyond the robot's limits: {beyond}" if beyond else "within the robot's limits"


def _policy(policy: PolicySteps | None, key: str) -> dict[str, Any] | None:
    """The policy's steps for the template; None without a policy."""
    if policy is None:
        return None
    step = 1e3 * policy.step_s
    full = list(policy.saturated.items())[:_MOST_SATURATED]
    facts = {
        "policy": policy.policy or "unknown",
        "steps": f"{policy.steps} of {step:g} ms",
        "late": f"{counted(policy.late, 'interval')} between steps of 1.5 steps or more"
        if policy.late
        else "",
        "repeated": f"{counted(policy.repeated, 'action')} that was not finite"
        if policy.repeated
        else "",
        "slack": f"the longest delay from state to command is {1e3 * policy.delay_s.max:.1f} ms, "
        f"{policy.delay_s.max / policy.step_s:.0%} of a step"
        if policy.delay_s
        else "",
        "at torque limits": ", ".join(f"{short_name(one)} {share:.2%}" for one, share in full)
        or "no motor",
    }
    return {
        "fall": str(policy.fall) if policy.fall else "",
        "facts": [(name, text) for name, text in facts.items() if text],
        **policy_tables(policy.model_dump(mode="json"), key),
    }


def session_physics(
    session: Session, summary: Summary, progress: Callable[[float], None]
) -> MotionPhysics | str:
    """The physics of a session's motion, or the reason why they are missing.

    They are computed from the attached motion's played frames if it was played unchanged,
    otherwise from the reference, or from the motion that `convert` converted.
    """
    if played(summary.phases) > 1:
        return "Several motions were played."
    fps, ended = (summary.motion and summary.motion.fps) or _FPS, summary.termination
    try:
        motion = session.motion() if session.converted else _attached_motion(session)
        if motion and ended.played_s:
            frames = Interval(ended.start_s, ended.played_s).frames(motion)
        else:
            frames = range(motion.n_frames if motion else round((ended.played_s or 0.0) * fps))
        if len(frames) > _MOST_FRAMES:
            return (
                f"{len(frames)} frames were played, more than the {_MOST_FRAMES} that a report "
                f"analyses: run g1stream physics {session.path.name}."
            )
        max_tilt = (summary.settings or {}).get("safety.max_tilt")
        return motion_physics(
            motion or session.motion(fps),
            session.robot,
            max_tilt=max_tilt if isinstance(max_tilt, float) else None,
            frames=frames if motion else None,  # the reference has no other frames
            progress=progress,
        )
    except (MotionError, RecordingError, RobotError) as error:
        return error.cause


def _picture(session: Session) -> dict[str, str]:
    """The video or picture beside a session file; empty for a session in memory."""
    shown = {"missing": "", "video": "", "image": ""}
    paths = [session.path.with_suffix(suffix) for suffix in _PICTURES] if session.paths else []
    if path := next(filter(Path.is_file, paths), None):
        try:
            data = base64.b64encode(read_file(path, _LARGEST_PICTURE)).decode()
        except OSError as error:
            return shown | {"missing": f"{path.name} is not shown: {error.strerror}."}
        kind = guess_type(path.name)[0] or ""
        shown[kind.partition("/")[0]] = f"data:{kind};base64,{data}"
    return shown


def _rendered(drawn: Sequence[Mapping[str, Any]], **values: Any) -> str:
    """Render the page with the script that draws its figures.

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
    text: str = environment.get_template("report.html").render(
        values,
        made=f"g1stream {__version__}, {datetime.now(timezone.utc):%Y-%m-%d %H:%M} UTC",
        style=_resource(jinja, "report.css"),
        script=_resource(jinja, "report.js"),
        plotly=_packed(plotly.get_plotlyjs()),
        figures=_packed(json.dumps(drawn)),
    )
    return text


def _joints_by_limb(shown: Container[str]) -> dict[str, dict[int, str]]:
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


def _attached_motion(session: Recording) -> Motion | None:
    """The motion in the attached file, if it is the one that was played.

    It is None if no file is attached, or if the played motion differs from the file's.
    """
    info, _ = read_record(MotionInfo, session.metadata.get("motion"))
    if info is None or info.source is None or info.content_sha256 is None:
        return None
    path = Path(info.source)
    member = None if info.name == path.stem else info.name  # its name in a file of several
    try:
        data = session.attachments[path.name]
        motion = MotionFile(path, info.fps, member=member, data=data).open().motion()
    except (KeyError, MotionError):
        return None
    return motion if motion.content_sha256 == info.content_sha256 else None
