"""A policy's network: an ONNX file, executed by onnxruntime on one thread."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Iterator, Mapping
from functools import cache, cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import numpy as np

from g1stream.errors import ConfigError
from g1stream.extras.policy.published import LARGEST, policy_path, published
from g1stream.files import read_file
from g1stream.optional import import_extra
from g1stream.types import Floats

__all__ = ["Network"]

#: Longest run, s; a step of a policy takes milliseconds.
_LONGEST: Final = 5.0
#: Most values of a state.
_LARGEST_STATE: Final = 1_000_000
#: Operators that may be between the observation and its normalisation.
_PASSED: Final = {"Cast", "Squeeze", "Clip", "Identity"}
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
    """A network from an observation, and maybe a time step and states, to an action.

    Args:
        path: path of the ONNX file, or name of a published policy.

    Attributes:
        path: path of the file.
        data: names of the files with external data beside it, which it names.
        metadata: its custom metadata, as text.
        width: width of the observation.
        outputs: width of each output, 0 if it is not that of an action; by name.
        first: name of the first output.
        inputs: shape and type of each input beside the observation and the time step, by name; a
            dimension of no known size is 1.
        fed_back: the output X_out for each of these that is called X_in, as rsl_rl exports states.
        holds_motion: whether its outputs, by a time step, are a motion.
        sha256: hash of the file.
        data_sha256: hash of the external data, of all files one after the other; None without any.

    Raises:
        ConfigError: it is no ONNX file, its inputs and outputs are not those of a policy, or it
            cannot be fetched.
    """

    def __init__(self, path: Path | str) -> None:
        # Since 1.29 it sends Microsoft the names and hashes of networks, unless this is set before.
        os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
        runtime = import_extra("onnxruntime", "policy", "A policy needs")
        self.path = policy_path(path)
        self._onnx = import_extra("onnx", "policy", "A policy needs")
        content = self._read(self.path.name)
        self.sha256 = sha256(content).hexdigest()
        try:
            model = self._onnx.load_model_from_string(content)
        except Exception as error:  # the class of protobuf's errors is not public in onnx
            raise self._unloadable(error) from error
        self._graph = model.graph
        tensors = [one for one in self._tensors(model) if one.external_data]
        entries = [one for tensor in tensors for one in tensor.external_data]
        self.data = sorted({one.value for one in entries if one.key == "location"})
        if outside := [one for one in self.data if one.startswith("/") or ".." in Path(one).parts]:
            raise self._unloadable(ValueError(f"{outside[0]} is not in the folder of the file"))
        external = b"".join(map(self._read, self.data))
        if len(content) + len(external) > LARGEST:
            raise self._unloadable(ValueError(f"it has more than {LARGEST >> 20} MB"))
        self.data_sha256 = sha256(external).hexdigest() if self.data else None
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
            raise self._unloadable(error) from error
        shapes, outputs = {one.name: list(one.shape) for one in inputs}, self._session.get_outputs()
        self._step = {"time_step": np.zeros((1, 1), np.float32)} if "time_step" in shapes else {}
        observations = [name for name in shapes if name != "time_step"]
        self.outputs = {one.name: _width(one.shape) for one in outputs}
        self.first = next(iter(self.outputs))
        self.holds_motion = bool(self._step) and {"joint_pos", "joint_vel"} <= set(self.outputs)
        self._observation = observations[0] if observations else ""
        self.width = _width(shapes[self._observation]) if observations else 0
        self.inputs = {one.name: _kind(one) for one in inputs if one.name in observations[1:]}
        self._kinds = {one.name: _kind(one) for one in outputs}
        pairs = ((name, f"{name[:-3]}_out") for name in self.inputs if name.endswith("_in"))
        self.fed_back = {name: output for name, output in pairs if output in self.outputs}
        self._feedback: Mapping[str, str] = {}
        self._states: dict[str, Any] = {}
        if not self.width:
            raise ConfigError(
                f"{self.path} takes {_shown(shapes)}, which is not an observation of known width.",
                "Export the actor alone, with one input (1, width) and perhaps time_step.",
            )

    def is_state(self, name: str, output: str | None) -> bool:
        """Whether an output can be an input in the next step: float32 of the same shape."""
        shape, kind = self.inputs[name]
        same = self._kinds.get(output or "") == (shape, kind)
        return same and kind == "tensor(float)" and math.prod(shape) <= _LARGEST_STATE

    def begin(self, feedback: Mapping[str, str]) -> None:
        """Begin a run, with zeros as states.

        Args:
            feedback: the output that is each state in the next step, by the name of its input.
        """
        self._feedback = feedback
        self._states = {name: np.zeros(self.inputs[name][0], np.float32) for name in feedback}

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
        observed = {self._observation: observation.astype(np.float32)[None]}
        feed = observed | self._step | self._states
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
        given = dict(zip(self.outputs, values, strict=True))
        self._states |= {name: given[output] for name, output in self._feedback.items()}
        batches = map(np.atleast_1d, values)  # a scalar may be an unused output
        return {name: value[0] for name, value in zip(self.outputs, batches, strict=True)}

    def act(self, observation: Floats, step: int = 0, output: str = "") -> Floats:
        """The action (joints,) for one observation (width,): an output, or the first one."""
        action: Floats = self.run(observation, step)[output or self.first].astype(np.float64)
        return action

    @cached_property
    def normaliser(self) -> tuple[Floats, Floats] | None:
        """Mean and deviation (width,) with which it normalises its observation; None without them.

        A network of rsl_rl or holosoma begins with (observation - mean) / deviation, both constant,
        if the training normalised: they are the statistics of the training.
        """
        constants = {one.name: one for one in self._graph.initializer}
        divisors = {one.input[0]: one.input[1] for one in self._graph.node if one.op_type == "Div"}
        values = self._observation
        for node in self._graph.node:
            if node.op_type in _PASSED and node.input[0] == values:
                values = node.output[0]
            elif node.op_type == "Sub" and node.input[0] == values:
                names = node.input[1], divisors.get(node.output[0])
                if not constants.keys() >= {*names}:
                    return None
                mean, deviation = (
                    self._onnx.numpy_helper.to_array(self._inside(constants[name]))
                    .astype(np.float64)
                    .ravel()
                    for name in names
                )
                sound = mean.size == deviation.size == self.width and (deviation > 0.0).all()
                return (mean, deviation) if sound and np.isfinite(mean).all() else None
        return None

    def _inside(self, tensor: Any) -> Any:
        """The tensor with its external data in it; onnx refuses those behind a link."""
        told = {one.key: one.value for one in tensor.external_data}
        if told:
            start, content = int(told.get("offset", 0)), self._read(told["location"])
            end = start + int(told["length"]) if "length" in told else None
            tensor = type(tensor)(dims=tensor.dims, data_type=tensor.data_type)
            tensor.raw_data = content[start:end]
        return tensor

    def _tensors(self, message: Any) -> Iterator[Any]:
        """All tensors in a message of ONNX, those in attributes and inner graphs included."""
        if isinstance(message, self._onnx.TensorProto):
            yield message
        else:
            for field, value in message.ListFields():
                if field.type == field.TYPE_MESSAGE:
                    for one in [value] if hasattr(value, "ListFields") else value:
                        yield from self._tensors(one)

    def _read(self, name: str) -> bytes:
        """The content of the file, or of external data beside it."""
        try:
            return read_file(self.path.parent / name, LARGEST)
        except OSError as error:
            raise ConfigError(
                f"The policy {self.path.parent / name} cannot be read: {error.strerror}.",
                "Give the path of an ONNX file with its external data beside it and no more than "
                f"the actor, or a published policy: {', '.join(published())}.",
            ) from error

    def _unloadable(self, error: Exception) -> ConfigError:
        return ConfigError(
            f"{self.path} cannot be loaded as a policy: {_reason(error)}.",
            "Give an ONNX file with standard operators, and its external data beside it.",
        )


def _width(shape: list[Any]) -> int:
    """The width of an input or output (1, width); 0 if it has another shape or no known one."""
    return shape[1] if len(shape) == 2 and isinstance(shape[1], int) else 0


def _kind(value: Any) -> tuple[tuple[int, ...], str]:
    """Shape and type of an input or output."""
    return tuple(size if isinstance(size, int) else 1 for size in value.shape), value.type


def _reason(error: Exception) -> str:
    """The last part of onnxruntime's error, which is the cause, on one line."""
    text = " ".join(str(error).split())
    return text.rsplit(" : ", 1)[-1].rstrip(".")[:300]


def _shown(shapes: dict[str, list[object]]) -> str:
    return ", ".join(f"{name} {tuple(shape)}" for name, shape in shapes.items()) or "nothing"
