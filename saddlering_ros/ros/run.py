"""From a command line to a running node and its exit status, ended cleanly by a signal."""

from __future__ import annotations

import atexit
from collections.abc import Callable, Sequence
import contextlib
import ctypes
import gc
import os
import signal
import sys
from typing import Any, NoReturn

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from saddlering_ros.errors import SaddleringError
from saddlering_ros.ros.lifeline import follow_lifeline
from saddlering_ros.ros.parameters import check_parameter_files, refuse_undeclared
from saddlering_ros.ros.shared_memory import sweep
from saddlering_ros.ros.spin import spin_streaming
from saddlering_ros.ros.starting import end_as_usual, is_node_program
from saddlering_ros.ros.streaming_node import StreamingNode
from saddlering_ros.ros.transport import prepare_transport

UNUSABLE = 2
LONGEST_END = 3.0
"""Longest time [s] for the middleware to leave the network; a launch grants five in all."""


def run_streaming(make: Callable[[], StreamingNode], args: Sequence[str] | None = None) -> int:
    """Run a streaming node until it is done or a signal ends it; returns the exit status."""
    def spin(node: StreamingNode) -> None:
        node.start()
        keep_out_of_collections()
        spin_streaming(node, node)
    return run(make, spin, args)


def run(make: Callable[[], Any], spin: Callable[[Any], None],
        args: Sequence[str] | None = None, *, own_signals: bool = False) -> int:
    """Make a node, spin it, clean up; one line and status 2 for an error of the user.

    With `own_signals`, `spin` itself sees to SIGINT and SIGTERM.
    """
    follow_lifeline()
    sweep()
    node: Node | None = None
    try:
        check_parameter_files(sys.argv if args is None else args)
        prepare_transport()
        if is_node_program():
            end_as_usual()
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO if own_signals
                   else SignalHandlerOptions.ALL)
        node = make()
        refuse_undeclared(node)
        spin(node)
        return 0
    except SaddleringError as problem:
        print(_one_line(str(problem)), file=sys.stderr)
        return UNUSABLE
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except Exception as problem:
        if node is not None and not node.context.ok():
            return 0  # a signal came in the middle of work
        if node is not None or not _is_usage(problem):
            raise
        print(_one_line(str(problem)), file=sys.stderr)
        return UNUSABLE
    finally:
        _clean_up(node)


def keep_out_of_collections() -> None:
    """Exempt all objects there are from the collection of garbage.

    A full collection looks at every object of every imported library, which takes tens of
    milliseconds in the middle of a stream.
    """
    gc.collect()
    gc.freeze()


def leave(status: int, longest: float = LONGEST_END) -> NoReturn:
    """End the process with `status` after all functions that were registered for the end.

    The interpreter is not finalized. With compiled kernels that takes longer than everything
    else, and a launch file gives all its nodes together five seconds to end.

    The work of the node is done and written by now. The status is therefore kept even if the
    middleware crashes or hangs while it leaves the network. Fast DDS sometimes does so when many
    nodes end at once. The middleware is abandoned after `longest` seconds. No line is printed:
    nothing is lost, and other participants forget this one after its lease.
    """
    handler = _abandon_middleware(status, longest)
    gc.unfreeze()
    gc.collect()  # the node leaves the network
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    del handler
    os._exit(status)


def _abandon_middleware(status: int, longest: float) -> object:
    """End with `status` at a crash of this process from now on, or after `longest` seconds.

    Returns the handler, which must be kept until then.

    The handlers are those of the C runtime: the middleware may keep the interpreter while it
    hangs, and Python would run its own handlers only after that.
    """
    def end(_number: int) -> None:
        os._exit(status)

    handler_type = ctypes.CFUNCTYPE(None, ctypes.c_int)
    handler = handler_type(end)
    set_handler = ctypes.CDLL(None).signal
    set_handler.argtypes, set_handler.restype = (ctypes.c_int, handler_type), ctypes.c_void_p
    for number in (signal.SIGALRM, signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS):
        set_handler(number, handler)
    signal.setitimer(signal.ITIMER_REAL, longest)
    return handler


def _clean_up(node: Node | None) -> None:
    """Destroy the node and the context; a second Ctrl-C must not interrupt this."""
    for number in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(ValueError):
            signal.signal(number, signal.SIG_IGN)
    if node is not None:
        with contextlib.suppress(Exception):
            node.destroy_node()
    with contextlib.suppress(Exception):
        rclpy.try_shutdown()


def _is_usage(problem: Exception) -> bool:
    """Whether rclpy refused the command line (--ros-args, a parameter file it cannot read)."""
    return type(problem).__name__ in (
        'RCLError', 'UnknownROSArgsError', 'InvalidNodeNameException', 'RCLInvalidROSArgsError',
        'InvalidNamespaceException')


def _one_line(text: str) -> str:
    return ' '.join(text.split())
