"""An engine without solvers: attempts end by themselves after a time, all kept in this process."""

import heapq
import itertools
import threading
import time

from wrenchbook.service.jobs.attempt import OUTCOME, Outcome, write_outcome


class SimulatedEngine:
    """Workers that are merely waited for, as on a cluster: nothing of this machine but files.

    Parameters
    ----------
    slots : int
    seconds : callable
        Gives how long an attempt takes; None lets it run until `end_all`.
    """

    def __init__(self, slots, seconds, name="simulated"):
        self.name = name
        self.slots = slots
        self.submitted, self.attached, self.cancelled = [], [], []
        self._seconds = seconds
        self._states = {}
        self._due, self._held = [], []
        self._ties = itertools.count()
        self._changed = threading.Condition()
        self._listeners = []
        self._closed = False
        threading.Thread(target=self._work, daemon=True).start()

    def submit(self, attempt):
        seconds = self._seconds(attempt)
        with self._changed:
            self.submitted.append(attempt.task)
            self._states[attempt.task] = "running"
            if seconds is None:
                self._held.append(attempt)
                return
            due = time.monotonic() + seconds, next(self._ties), attempt
            heapq.heappush(self._due, due)
            if self._due[0] is due:
                self._changed.notify()

    def end_all(self):
        """End now what would run for ever."""
        with self._changed:
            for attempt in self._held:
                heapq.heappush(self._due, (0.0, next(self._ties), attempt))
            self._held.clear()
            self._changed.notify()

    def attach(self, attempt):
        self.attached.append(attempt.task)
        self._states.setdefault(attempt.task, "lost")

    def poll(self, attempt):
        if (state := self._states.get(attempt.task)) != "running":
            return state or ("finished" if (attempt.folder / OUTCOME).exists() else "lost")
        return state

    def cancel(self, attempt):
        self.cancelled.append(attempt.task)
        self._states[attempt.task] = "lost"

    def forget(self, attempt):
        self._states.pop(attempt.task, None)

    def listen(self, heard):
        self._listeners.append(heard)
        return lambda: self._listeners.remove(heard)

    def close(self):
        with self._changed:
            self._closed = True
            self._changed.notify()

    def _work(self):
        while not self._closed:
            with self._changed:
                wait = self._due[0][0] - time.monotonic() if self._due else None
                if wait is None or wait > 0:
                    self._changed.wait(wait)
                    continue
                attempt = heapq.heappop(self._due)[2]
            answer = [load * 1e-6 for load in attempt.wrench]
            write_outcome(attempt, Outcome("done", displacement=answer))
            if self._states.get(attempt.task) == "running":
                self._states[attempt.task] = "finished"
            for heard in tuple(self._listeners):
                heard(attempt.task)
