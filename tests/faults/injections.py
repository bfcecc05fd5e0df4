"""What can be done to a session: files and settings before it, and acts while it plays."""

from __future__ import annotations

import fcntl
import importlib.util
import os
import pty
import signal
import subprocess
import sys
import termios
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from engine import ENVIRONMENT, Session, sway, write_motion
from g1 import JOINTS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    Prepare = Callable[[Session], Sequence[str]]
    Act = Callable[[Session], None]

KNEE, ELBOW = JOINTS.index("left_knee_joint"), JOINTS.index("right_elbow_joint")
WRIST = JOINTS.index("left_wrist_pitch_joint")


def _run(*command: str | Path) -> None:
    subprocess.run(command, check=True, env=ENVIRONMENT)


def flags(*words: str) -> Prepare:
    return lambda session: words


def cell(value: Any, *words: str) -> Prepare:
    """One cell of the motion file changed; more arguments of the command."""

    def prepare(session: Session) -> Sequence[str]:
        joints = sway().astype(object)
        joints[30, KNEE] = value
        write_motion(session.motion, joints)
        return words

    return prepare


def settings(text: str) -> Prepare:
    def prepare(session: Session) -> Sequence[str]:
        session.set(text)
        return []

    return prepare


def constants(**values: float) -> Prepare:
    """Other constants of the profile `simulator`."""

    def prepare(session: Session) -> Sequence[str]:
        session.customise(CONSTANTS.format(profile="simulator", values=values))
        return []

    return prepare


def wide_urdf(session: Session) -> Sequence[str]:
    """A URDF whose knees bend further than those of a G1, and a motion that uses it."""
    package = importlib.util.find_spec("g1stream")
    assert package
    assert package.submodule_search_locations
    (place,) = package.submodule_search_locations
    text = Path(place, "robot", "g1_29dof.urdf").read_text()
    urdf = session.folder / "wide.urdf"
    urdf.write_text(text.replace('upper="2.8798"', 'upper="4.0"'))
    joints = sway()
    joints[:, KNEE] *= 3.4 / 0.9
    write_motion(session.motion, joints)
    return ["--robot", str(urdf)]


def symlink(session: Session) -> Sequence[str]:
    victim = session.folder / "victim.txt"
    victim.write_text("precious")
    session.path.symlink_to(victim)
    session.clean_up.append(lambda: _assert_kept(victim))
    return ["--force"]


def _assert_kept(victim: Path) -> None:
    assert victim.read_text() == "precious"


CONSTANTS: Final = """
from g1stream.profiles import PROFILES
PROFILES["{profile}"] = PROFILES["{profile}"]._replace(**{values})
"""

#: From the 300th on, each write of a command of the process of the stream itself does this first.
WRITER: Final = """
import sys
if sys.orig_argv[1:3] == ["-m", "g1stream"]:
    import time
    from cyclonedds.core import DDSException
    from cyclonedds.pub import DataWriter
    write, written = DataWriter.write, []
    def begin(self, sample, timestamp=None):
        if "LowCmd" in type(sample).__name__:
            written.append(1)
            if len(written) > 300:
                {first}
        return write(self, sample, timestamp)
    DataWriter.write = begin
"""
BROKEN: Final = "raise DDSException(DDSException.DDS_RETCODE_TIMEOUT)"


def writer(first: str, before: Prepare = lambda session: []) -> Prepare:
    """A writer that does something before each write, and what else is prepared."""

    def prepare(session: Session) -> Sequence[str]:
        session.customise(WRITER.format(first=first))
        return before(session)

    return prepare


def no_guard_from_the_start(session: Session) -> Sequence[str]:
    """Kill the guard process as soon as there is one."""

    def kill() -> None:
        while not getattr(session, "process", None) or not session.children("guard"):
            time.sleep(0.01)
        os.kill(session.guard(), signal.SIGKILL)

    threading.Thread(target=kill, daemon=True).start()
    return []


def another_stream(session: Session) -> None:
    """Start a second one in the same domain, which has to refuse."""
    command = [sys.executable, "-m", "g1stream", "stream", str(session.motion)]
    command += ["--config", str(session.config), "--domain", str(session.domain)]
    second = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    told = "rt/lowcmd" in second.stderr and f"pid {session.process.pid} " in second.stderr
    if second.returncode != 2 or not told:
        session.wrong.append(f"the second stream: {second.stderr}")


def send(number: int) -> Act:
    return lambda session: session.process.send_signal(number)


def twice(session: Session) -> None:
    """Ctrl-C, and again while it damps."""
    session.process.send_signal(signal.SIGINT)
    time.sleep(0.2)
    session.process.send_signal(signal.SIGINT)


def stop(seconds: float, then: int = signal.SIGCONT) -> Act:
    """Stop the process, and send it another signal after some seconds."""

    def act(session: Session) -> None:
        session.process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        session.process.send_signal(then)

    return act


def on_terminal(session: Session) -> Sequence[str]:
    """Give the command a terminal of its own, which `close_terminal` takes away."""
    session.screen, session.terminal = pty.openpty()
    session.before = _own_terminal
    return []


def _own_terminal() -> None:
    os.setsid()
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


def close_terminal(session: Session) -> None:
    os.close(session.screen)


def to_recorder(number: int) -> Act:
    return lambda session: os.kill(session.recorder(), number)


def to_receiver(number: int) -> Act:
    return lambda session: os.kill(session.receiver(), number)


def to_guard(number: int) -> Act:
    return lambda session: os.kill(session.guard(), number)


def replace_file(session: Session) -> None:
    session.path.rename(session.path.with_suffix(".old"))
    session.path.write_text("precious")
    session.clean_up.append(lambda: _assert_kept(session.path))


def small_disk(session: Session) -> Sequence[str]:
    place = session.folder / "disk"
    place.mkdir()
    _run("mount", "-t", "tmpfs", "-o", "size=1m", "none", place)
    session.path = place / "session.mcap"
    session.clean_up.append(lambda: _run("umount", "-l", place))
    return []


def hogs(session: Session) -> None:
    """Eight busy processes for 3 s on the streamer's only CPU, where it has no priority."""
    burn = "import time; end = time.time() + 3\nwhile time.time() < end: pass"
    command = [sys.executable, "-c", burn]
    for _ in range(8):
        hog = subprocess.Popen(command, env=ENVIRONMENT, preexec_fn=_pin)  # noqa: PLW1509
        session.clean_up.append(hog.wait)


def _pin() -> None:
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def _pin_politely() -> None:
    _pin()
    os.nice(19)


def no_priority(before: Prepare = lambda session: []) -> Prepare:
    def prepare(session: Session) -> Sequence[str]:
        session.set("[realtime]\npriority = 0\n")
        session.before = _pin_politely
        return before(session)

    return prepare


CLOCK: Final = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>
static long step(void) {
  return access(getenv("CLOCK_STEP_FILE"), F_OK) ? 0 : atol(getenv("CLOCK_STEP"));
}
int clock_gettime(clockid_t id, struct timespec *t) {
  static int (*real)(clockid_t, struct timespec *);
  if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
  int r = real(id, t);
  if (id == CLOCK_REALTIME) t->tv_sec += step();
  return r;
}
/* A deadline of the stepped clock, as the kernel's clock has it; one of years is no uptime. */
int pthread_cond_timedwait(pthread_cond_t *c, pthread_mutex_t *m, const struct timespec *t) {
  static int (*real)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
  if (!real) real = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
  if (!real) real = dlsym(RTLD_NEXT, "pthread_cond_timedwait");
  struct timespec then = *t;
  if (then.tv_sec > 1000000000) then.tv_sec -= step();
  return real(c, m, &then);
}
"""


def clock(step: int) -> Prepare:
    """The wall clock of the session's processes can step, by seconds, and no other's."""

    def prepare(session: Session) -> Sequence[str]:
        source, library = session.folder / "clock.c", session.folder / "clock.so"
        source.write_text(CLOCK)
        _run("gcc", "-shared", "-fPIC", "-o", library, source, "-ldl")
        session.environment |= {
            "LD_PRELOAD": str(library),
            "CLOCK_STEP": str(step),
            "CLOCK_STEP_FILE": str(session.folder / "now"),
        }
        return []

    return prepare


def step_clock(session: Session) -> None:
    (session.folder / "now").touch()


def network(*words: str) -> Prepare:
    """Both sides on a network interface that is not the loopback, in a namespace of their own."""

    def prepare(session: Session) -> Sequence[str]:
        name = f"g1faults{session.domain}"
        session.interface, session.prefix = "eth0", ["ip", "netns", "exec", name]
        _run("ip", "netns", "add", name)
        session.clean_up.append(lambda: _run("ip", "netns", "delete", name))
        for command in (
            "link set lo up",
            "link add eth0 type veth peer name robot",
            "addr add 10.77.0.1/24 dev eth0",
            "link set eth0 up",
            "link set robot up",
        ):
            _run("ip", "-n", name, *command.split())
        return ["--interface", "eth0", *words]

    return prepare
