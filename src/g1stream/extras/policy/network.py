"""A policy's network: an ONNX file, executed by onnxruntime on one thread."""

from __future__ import annotations

import hashlib
import threading
import time
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from g1stream.errors import ConfigError
from g1stream.extras.policy.normaliser import normaliser
from g1stream.extras.policy.published import LARGEST, policy_path, published
from g1stream.optional import import_extra
from g1stream.types import Floats

__all__ = ["Network"]

#: Longest run, s; a step of a policy takes milliseconds.
_LONGEST: Final = 5.0
#: Start, s of CLOCK_MONOTONIC, and options of the runs that have not ended.
_RUNNING: Final[dict[int, tuple[float, Any]]] = {}


@cache
def _end_long_runs() -> None:
    """Start the thread that ends runs of any network that take too long."""

    def watch() -> None:
        while True:
            time.sleep(_LONGEST / 10)
            for begun, options in list(_RUNNING.values()):
                if time.monotonic() - begun > _LONGEST:
                    options.terminate = True

    threading.Thread(target=watch, name="network", daemon=True).start()


class Network:
    """A network from an observation, and maybe a time step, to an action.

    Args:
        path: path of the ONNX file, or name of a published policy.

    Attributes:
        path: path of the file.
        metadata: its custom metadata, as text.
        width: width of the observation.
        outputs: width of each output, 0 if it is not that of an action; by name.
        first: name of the first output.
        holds_motion: whether its outputs, by a time step, are a motion.
        sha256: hash of the file.
        data_sha256: hash of the external data `<name>.data` beside it; None without that file.

    Raises:
        ConfigError: it is no ONNX file, its inputs and outputs are not those of a policy, or it
            cannot be fetched.
    """

    def __init__(self, path: Path | str) -> None:
        runtime = import_extra("onnxruntime", "policy", "A policy needs")
        self.path = policy_path(path)
        data = self._check_size()
        self.sha256 = _sha256(self.path)
        self.data_sha256 = _sha256(data) if data else None
        self._run_options = runtime.RunOptions
        _end_long_runs()
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4  # its errors are raised as exceptions, too
        try:
            self._session = runtime.InferenceSession(
                str(self.path), options, providers=["CPUExecutionProvider"]
            )
            told, inputs = self._session.get_modelmeta(), self._session.get_inputs()
            self.metadata: dict[str, str] = dict(told.custom_metadata_map)
        except Exception as error:  # of onnxruntime, or of text that is not UTF-8
            raise ConfigError(
                f"{self.path} cannot be loaded as a policy: {_reason(error)}.",
                "Give an ONNX file with standard operators, and its external data beside it.",
            ) from error
        shapes = {one.name: list(one.shape) for one in inputs}
        self._step = {"time_step": np.zeros((1, 1), np.float32)} if "time_step" in shapes else {}
        observations = [name for name in shapes if name != "time_step"]
        self.outputs = {one.name: _width(one.shape) for one in self._session.get_outputs()}
        self.first = next(iter(self.outputs))
        self.holds_motion = bool(self._step) and {"joint_pos", "joint_vel"} <= set(self.outputs)
        self._observation = observations[0] if observations else ""
        self.width = _width(shapes[self._observation]) if observations else 0
        if len(observations) > 1:
            raise ConfigError(
                f"{self.path} takes {_shown(shapes)}: beside an observation, a state that is fed "
                "back or the output of another network, such as an encoder.",
                "Export all of it as one network with one input (1, width), or run it in its own "
                "program and record that: `g1stream record`.",
            )
        if not self.width:
            raise ConfigError(
                f"{self.path} takes {_shown(shapes)}, which is not an observation of known width.",
                "Export the actor alone, with one input (1, width) and perhaps time_step.",
            )

    def run(self, observation: Floats, step: int = 0) -> dict[str, Floats]:
        """All outputs for one observation (width,), by name and without the batch dimension.

        Args:
            observation: values in the order of the network.
            step: time step of the motion in the file, if the network takes it.

        Raises:
            ConfigError: the network fails, or takes longer than 5 s.
        """
        for value in self._step.values():
            value[:] = step
        feed = {self._observation: observation.astype(np.float32)[None], **self._step}
        # Signals are not handled meanwhile, as Python does so between two of its instructions.
        options = self._run_options()
        options.log_severity_level = 4
        _RUNNING[id(options)] = time.monotonic(), options
        try:
            values = self._session.run(None, feed, options)
        except Exception as error:  # onnxruntime's error classes are not public
            reason = f"it takes longer than {_LONGEST:g} s" if options.terminate else _reason(error)
            raise ConfigError(
                f"The network of {self.path} fails: {reason}.",
                "Export it for a batch of 1 and float32 inputs.",
            ) from error
        finally:
            del _RUNNING[id(options)]
        batches = map(np.atleast_1d, values)  # a scalar may be an unused output
        return {name: value[0] for name, value in zip(self.outputs, batches, strict=True)}

    def act(self, observation: Floats, step: int = 0, output: str = "") -> Floats:
        """The action (joints,) for one observation (width,): an output, or the first one."""
        action: Floats = self.run(observation, step)[output or self.first].astype(np.float64)
        return action

    @cached_property
    def normaliser(self) -> tuple[Floats, Floats] | None:
        """Mean and deviation (width,) of its observation normalisation; None without one."""
        return normaliser(self.path, self._observation, self.width)

    def _check_size(self) -> Path | None:
        """Check the file's size, and return the external data beside it; None without it."""
        try:
            size = self.path.stat().st_size
            data = self.path.with_name(f"{self.path.name}.data")
            external = data if data.exists() else None
            size += external.stat().st_size if external else 0
        except OSError as error:
            raise ConfigError(
                f"The policy {self.path} cannot be read: {error.strerror}.",
                f"Give the path of an ONNX file, or a published policy: {', '.join(published())}.",
            ) from error
        if not self.path.is_file():
            raise ConfigError(f"The policy {self.path} is not a file.", "Give an ONNX file.")
        if size > LARGEST:
            raise ConfigError(
                f"The policy {self.path} has {size / 2**20:.0f} MB, more than the limit of "
                f"{LARGEST / 2**20:.0f} MB.",
                "Export the actor alone, without critic and optimiser.",
            )
        return external


def _width(shape: list[Any]) -> int:
    """The width of an input or output (1, width); 0 if it has another shape or no known one."""
    return shape[1] if len(shape) == 2 and isinstance(shape[1], int) else 0


def _sha256(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ConfigError(
            f"The policy {path} cannot be read: {error.strerror}.", "Check the path."
        ) from error


def _reason(error: Exception) -> str:
    """The last part of onnxruntime's error, which is the cause, on one line."""
    text = " ".join(str(error).split())
    return text.rsplit(" : ", 1)[-1].rstrip(".")[:300]


def _shown(shapes: dict[str, list[object]]) -> str:
    return ", ".join(f"{name} {tuple(shape)}" for name, shape in shapes.items()) or "nothing"
