"""A node of this process in a context of its own, served by a thread."""

import threading
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor

POLL = 0.01
"""Between two looks at what came [s]; a shorter one takes a core from the nodes."""


class ServedNode:
    """Serves its callbacks and takes what has come, under `lock`, until it is closed.

    A subclass makes its subscriptions and then calls `serve`.
    """

    def __init__(self, domain: int, name: str) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node(name, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.lock = threading.RLock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def serve(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def take(self) -> None:
        """Take what the raw subscriptions hold."""

    def _serve(self) -> None:
        while not self._stop.is_set():
            with self.lock:
                self.executor.spin_once(timeout_sec=0.0)
                self.take()
            time.sleep(POLL)

    def close(self) -> None:
        """End the thread, then the node and its context."""
        self._stop.set()
        self._thread.join()
        self.executor.shutdown(timeout_sec=0.0)
        self.release()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def release(self) -> None:
        """Destroy what the node itself does not destroy."""
