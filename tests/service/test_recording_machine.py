"""Recordings and envelopes of the ledger against a dict, under any order of calls and restarts."""

import shutil
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from tests.service.test_recording_store import Library
from wrenchbook.service.ledger import BlockKeyError, Ledger, packed
from wrenchbook.service.recording.store import RecordingStore

# Within 1e-6 of the range of each other, apart, and outside the range.
LOADS = st.sampled_from([0.0, -0.0, 5e-6, 1.0, -3.0, 11.0])
BLOCKS = st.lists(st.tuples(LOADS, st.just(0.0), LOADS, *[st.just(0.0)] * 3), max_size=5)
NAMES = st.sampled_from(["bar", "plate"])
KINDS = st.sampled_from(["recording", "envelope"])
MERGE = 1e-6 * 10.0 * (1 + 1e-9)


class Reference:
    """What a recording and an envelope are, in plain lists."""

    def __init__(self):
        self.kept, self.total, self.outside = [], 0, 0
        self.low, self.high, self.count = None, None, 0

    def take(self, kind, block):
        if kind == "recording":
            self.total += len(block)
            self.outside += sum(abs(max(item, key=abs)) > 10 for item in block)
            for wrench in block:
                if all(self.apart(wrench, item) > MERGE for item in self.kept):
                    self.kept.append(wrench)
            return
        self.count += len(block)
        for wrench in block:
            self.low = wrench if self.low is None else tuple(map(min, self.low, wrench))
            self.high = wrench if self.high is None else tuple(map(max, self.high, wrench))

    def apart(self, first, second):
        return max(abs(a - b) for a, b in zip(first, second, strict=True))

    def clear(self, kind):
        if kind == "recording":
            self.kept, self.total, self.outside = [], 0, 0
        else:
            self.low, self.high, self.count = None, None, 0


class RecordingAgainstReference(RuleBasedStateMachine):
    def __init__(self):
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        self.keys = {}
        self.expected = {"bar": Reference(), "plate": Reference()}
        self.open()

    def open(self):
        self.ledger = Ledger(self.folder / "ledger.sqlite")
        workspace = SimpleNamespace(library=Library(), ledger=self.ledger)
        self.gathering = RecordingStore(workspace)
        self.other = RecordingStore(workspace)  # another process, with subsets of its own

    def teardown(self):
        self.ledger.close()
        shutil.rmtree(self.folder)

    @rule(name=NAMES, kind=KINDS, block=BLOCKS, sequence=st.none() | st.integers(0, 3),
          elsewhere=st.booleans())  # fmt: skip
    def send(self, name, kind, block, sequence, elsewhere):
        gathering = self.other if elsewhere else self.gathering
        wrenches = np.array(block, dtype=float).reshape(-1, 6) + 0.0
        key = None if sequence is None else ("me", sequence)
        before = self.keys.get((name, kind, sequence)) if sequence is not None else None
        try:
            if kind == "recording":
                took = gathering.record(name, wrenches, key)
            else:
                took, _ = gathering.widen(name, wrenches, key)
        except BlockKeyError:
            assert before is not None
            assert before != packed(wrenches)
            return
        assert took.known == (before is not None)
        if before is None:
            self.expected[name].take(kind, [tuple(wrench) for wrench in wrenches.tolist()])
            if sequence is not None:
                self.keys[name, kind, sequence] = packed(wrenches)

    @rule(name=NAMES, kind=KINDS)
    def clear(self, name, kind):
        self.gathering.clear(name, kind)
        self.expected[name].clear(kind)

    @rule()
    def open_again(self):
        self.ledger.close()
        self.open()

    @invariant()
    def all_agree(self):
        for name, expected in self.expected.items():
            result = self.gathering.recording(name)
            assert [tuple(wrench) for wrench in result.wrenches.tolist()] == expected.kept
            tally = result.tally
            assert (tally.offered, tally.outside) == (expected.total, expected.outside)
            assert tally.offered - tally.merged - tally.thinned == len(expected.kept)
            envelope = self.gathering.envelope(name)
            assert envelope.tally.offered == expected.count
            if expected.low is None:
                assert not len(envelope.lowest)
                continue
            low, high = envelope.box
            assert (tuple(low), tuple(high)) == (expected.low, expected.high)


TestRecordingAgainstReference = RecordingAgainstReference.TestCase
TestRecordingAgainstReference.settings = settings(max_examples=60, stateful_step_count=25)
