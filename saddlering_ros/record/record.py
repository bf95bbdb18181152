"""The record of one test: as recorded, aligned on the stamps of the load, and as averages."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
from pathlib import Path
from typing import Any

import numpy as np

from saddlering_ros.errors import BagError, plain_number, printable
from saddlering_ros.files import Origin
from saddlering_ros.record.batches import Bits, DOUBTFUL_LOAD, Floats, Mask, Samples, Stamps
from saddlering_ros.record.quality import doubtful_lag, TopicQuality
from saddlering_ros.record.scratch import BLOCK, blocks, scratch_array, spread_changes
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.rig import Rig


@dataclass(frozen=True)
class RawTopic:
    """One rig topic as recorded, in stamp order, each stamp once."""

    topic: str
    type: str
    frame_id: str
    stamps: Stamps  # (N,) [ns] of the headers, strictly increasing
    values: Floats  # (N,): force.x [N] of the load, range [m] of a probe
    min_range: float = math.nan  # [m] as a probe publishes it; NaN for the load
    max_range: float = math.nan  # [m], likewise
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def samples(self) -> Samples:
        return Samples(self.stamps, self.values, self.min_range, self.max_range)


@dataclass(frozen=True)
class RawRecord:
    """The rig topics of a bag by name, and its test metadata."""

    path: Path
    topics: dict[str, RawTopic]
    facts: 'TestMetadata'
    notes: tuple[str, ...] = ()

    def __getitem__(self, topic: str) -> RawTopic:
        return self.topics[topic]

    def __iter__(self) -> Iterator[str]:
        return iter(self.topics)

    def __len__(self) -> int:
        return len(self.topics)

    @property
    def rig(self) -> str:
        """Name of the rig that the bag states, as free text."""
        return self.facts.rig

    @property
    def rig_hash(self) -> str:
        """Hash of the rig's description that the bag states ('' if it states none)."""
        return self.facts.details.get('rig_hash', '')

    @property
    def start(self) -> int:
        """Earliest stamp of all topics [ns]."""
        return min(int(topic.stamps[0]) for topic in self.topics.values())

    @property
    def stop(self) -> int:
        """Latest stamp of all topics [ns]."""
        return max(int(topic.stamps[-1]) for topic in self.topics.values())


@dataclass(frozen=True)
class Record:
    """A test, aligned on the load's stamps."""

    name: str
    path: Path
    test: str  # 'static' or 'dynamic'
    elevation: float  # [rad]
    rig: str  # free text
    run: str  # free text
    stamps: Stamps  # (N,) [ns] of the load's headers
    time: Floats  # (N,) [s] since the first of them
    load: Floats  # (N,) [N]
    gaps: Floats  # (4, N) [m] at the load's stamps, NaN outside a probe's span and inside its gaps
    notes: list[str] = field(default_factory=list)  # faults of the bag that do not prevent its use
    sha256: str = ''  # of the bag's files; '' for a run without a bag
    spikes: Mask | None = None  # (5, N), of the load and the four probes; None: nowhere
    quality: dict[str, TopicQuality] = field(default_factory=dict)  # of the logger, by topic
    others: dict[str, Floats] = field(default_factory=dict)  # (N,) of optional topics, by name
    details: Mapping[str, str] = field(default_factory=dict)  # further metadata, such as rig_hash
    used: Mask | None = None  # (N,): rows from which a zero is taken; None: all complete ones
    published: Mask | None = None  # (N,): rows that live nodes publish after it; None: the same
    probe_marks: Bits | None = None  # (N,): validity by refused readings of probes; None: none
    load_marks: Bits | None = None  # (N,): the same by refused or doubtful loads
    has_one_clock: bool = True  # no topic is stamped by another clock than the others
    absent: int = 0  # radial probe that the rig lacks; its gaps mirror the other; 0: it has all

    def without_spikes(self) -> 'Record':
        """The same with sound readings only: NaN in the gaps, a straight line in the load.

        Spikes, values interpolated across a refused reading, and values beside a doubtful
        load are left out. Rows that lack a probe are not complete.
        """
        load, gaps = self.sound(slice(None))
        return replace(self, load=load, gaps=gaps, spikes=None, used=None, published=None,
                       probe_marks=None, load_marks=None)

    def sound(self, rows: slice) -> tuple[Floats, Floats]:
        """Load (M,) and gaps (4, M) of some rows, as `without_spikes` has them."""
        load, gaps = self.load[rows], self.gaps[:, rows]
        doubtful: Mask = np.zeros(len(load), dtype=bool)
        if self.load_marks is not None:
            doubtful = self.load_marks[rows] & DOUBTFUL_LOAD > 0
        struck = doubtful if self.spikes is None else doubtful | self.spikes[0, rows]
        if struck.any() and not struck.all():
            time, load = self.time[rows], load.copy()
            load[struck] = np.interp(time[struck], time[~struck], load[~struck])
        if self.probe_marks is not None:
            doubtful = doubtful | (self.probe_marks[rows] > 0)
        wrong = np.broadcast_to(doubtful, gaps.shape)
        if self.spikes is not None:
            wrong = wrong | self.spikes[1:, rows]
        return load, np.where(wrong, np.nan, gaps) if wrong.any() else gaps

    @property
    def given(self) -> Mask:
        """Mask (N,) of the load stamps from which a zero is taken."""
        return self.complete if self.used is None else self.used

    @property
    def rig_hash(self) -> str:
        """Hash of the rig's description that the bag states ('' if it states none)."""
        return self.details.get('rig_hash', '')

    @property
    def ring(self) -> str:
        """Name of the ring that the bag states, or else of the rig."""
        return self.details.get('ring') or self.rig

    @property
    def doubtful_lag(self) -> float:
        """Largest delay [s] between load and probes that the readings leave open."""
        if not self.quality:
            return 0.0
        probes = [self.quality[name] for name in PROBE_TOPICS]
        return doubtful_lag(self.quality[LOAD_TOPIC], probes, float(self.time[-1]))

    @property
    def origin(self) -> Origin:
        """The bag and its hash, for a result's provenance."""
        return Origin(str(self.path), self.sha256)

    @property
    def complete(self) -> Mask:
        """Mask (N,) of the load stamps at which all four probes have a reading."""
        is_complete = scratch_array(self.stamps.shape, np.bool_)
        for block in blocks(len(is_complete), self.gaps, is_complete):
            is_complete[block] = np.isfinite(self.gaps[:, block]).all(axis=0)
        return is_complete


FIT_ROWS = 1 << 19
"""Samples of all runs together that a fit holds in memory."""

MIN_BLOCK_SHARE = 0.5
"""Smallest share of the samples of a block with a reading of a probe."""

MAX_BLOCK_SECONDS = 1.5
"""Length of a block, in usual lengths, beyond which it lies across a gap."""

SPAN_MARGIN = 1e-4
"""Distance from an end of the span, as a share of the span, within which a reading is at a
limit."""


def fit_limit(runs: Sequence[Record], rows: int = FIT_ROWS) -> int:
    """Largest number of samples that each of the runs of one fit may have.

    All runs together have `rows` samples then, so that the memory of a fit does not grow. Short
    runs are kept whole.
    """
    left, counts = rows, sorted(len(run.stamps) for run in runs)
    for shorter, count in enumerate(counts):
        share = left // (len(counts) - shorter)
        if count > share:
            return max(share, 1)
        left -= count
    return rows


def condensed(run: Record, rig: Rig, limit: int = FIT_ROWS) -> Record:
    """The run itself, or one of at most `limit` averages with a note if it is longer.

    Only sound readings count: none that is a spike, lies across a refused reading, or is at a
    limit of the probes' span. Load and probes are averaged alike, so that a simulation of the
    averages is the average of a simulation.
    """
    count = len(run.stamps)
    size = -(-count // limit)
    if size <= 1:
        return run
    period = float(np.median(spread_changes(run.stamps)))
    low, high = rig.probes.min_range, rig.probes.max_range
    margin = SPAN_MARGIN * (high - low)
    rows = count // size
    stamps, load = np.empty(rows, np.int64), np.empty(rows)
    gaps = np.empty((len(run.gaps), rows))
    per_part = max(1, BLOCK // size)
    for block in blocks(rows, run.stamps, run.time, run.load, run.gaps, size=per_part):
        samples = slice(block.start * size, block.stop * size)
        taken = run.stamps[samples].reshape(-1, size)
        stamps[block] = taken[:, 0] + (taken - taken[:, :1]).mean(axis=1).astype(np.int64)
        sound_load, sound_gaps = run.sound(samples)
        load[block] = sound_load.reshape(-1, size).mean(axis=1)
        read = sound_gaps.reshape(len(gaps), -1, size)
        # Means of blocks in which enough readings are known, and which do not lie across a gap.
        is_read = (read > low + margin) & (read < high - margin)
        counts = is_read.sum(axis=2)
        enough = (counts >= MIN_BLOCK_SHARE * size) & (
            taken[:, -1] - taken[:, 0] <= MAX_BLOCK_SECONDS * size * period)
        sums = np.where(is_read, read, 0.0).sum(axis=2)
        gaps[:, block] = np.where(enough, sums / np.maximum(counts, 1), np.nan)
    note = (f'{count} samples every {period * 1e-6:.3g} ms are averaged over {size} samples each, '
            'because the record is long')
    return replace(
        run, stamps=stamps, time=(stamps - stamps[0]) * 1e-9, load=load, gaps=gaps, others={},
        notes=[*run.notes, note], spikes=None, used=None, published=None,
        probe_marks=None, load_marks=None)


METADATA_RECORD = 'saddlering.test'
"""Name under which a file of messages holds the metadata."""

KEYS = ('test', 'elevation_deg', 'rig', 'run')
DETAILS = ('ring', 'bench', 'date', 'service_hours', 'maintenance', 'operator', 'slew_deg', 'base',
           'rig_hash', 'import_map', 'import_sources', 'instruments', 'recorder_note')
"""Further texts: names of ring and test rig, on the test, whether it follows a service, on the
place of the ring, whether the session is a base measurement, on the description of the rig
(Rig.digest), on the files of an import, on its instruments, and what a recorder found."""

KINDS = ('static', 'dynamic')
LOWEST_ELEVATION, HIGHEST_ELEVATION = -10.0, 90.0
"""Elevations [deg] from the depression of a gun to an upright barrel."""


@dataclass(frozen=True)
class TestMetadata:
    """Kind of a test, elevation [degrees], rig and run as free text."""

    __test__ = False

    test: str | None = None  # None: not stated, or not clearly
    elevation_deg: float | None = None  # None: the same
    rig: str = ''
    run: str = ''
    details: Mapping[str, str] = field(default_factory=dict)  # texts by their key in DETAILS
    conflicts: tuple[str, ...] = ()  # what is stated in two ways
    faults: tuple[str, ...] = ()  # what cannot be read

    def __post_init__(self) -> None:
        for name in ('rig', 'run'):
            object.__setattr__(self, name, printable(getattr(self, name)))
        details = {key: printable(text) for key, text in self.details.items()}
        object.__setattr__(self, 'details', details)
        if self.test is not None:
            check_kind(self.test, 'test metadata')
        if self.elevation_deg is not None:
            check_elevation(self.elevation_deg, 'test metadata')

    def as_text(self) -> dict[str, str]:
        """What is stated, in the form of a bag: text to text."""
        texts = {} if self.test is None else {'test': self.test}
        if self.elevation_deg is not None:
            texts['elevation_deg'] = repr(float(self.elevation_deg)).removesuffix('.0')
        return {**texts, 'rig': self.rig, 'run': self.run, **self.details}

    @property
    def problems(self) -> tuple[str, ...]:
        """Reasons that prevent the use of the metadata, one line each, without the bag's name."""
        said = ' '.join(self.conflicts + self.faults)
        missing = [
            f'does not state the {what}: give {option}, or add "{key}" to custom_data of '
            f'metadata.yaml or to the record {METADATA_RECORD}'
            for key, value, what, option in (
                ('test', self.test, 'kind of test', "test='static' or test='dynamic'"),
                ('elevation_deg', self.elevation_deg, 'elevation', 'elevation_deg=DEG'))
            if value is None and f'{key} is' not in said]
        return (*self.conflicts, *self.faults, *missing)

    def overruled(self, test: str | None, elevation_deg: float | None) -> 'TestMetadata':
        """The same with values of options in place of those of the bag."""
        given: dict[str, Any] = {}
        if test is not None:
            given['test'] = check_kind(test, 'option')
        if elevation_deg is not None:
            given['elevation_deg'] = check_elevation(elevation_deg, 'option')
        conflicts, faults = (
            tuple(line for line in lines if line.partition(' is ')[0] not in given)
            for lines in (self.conflicts, self.faults))
        return replace(self, conflicts=conflicts, faults=faults, **given)


def check_kind(test: str, where: str) -> str:
    """The kind of test if it is a known kind."""
    if test not in KINDS:
        raise BagError(f'{where}: test is {test!r}: give static or dynamic')
    return test


def check_elevation(elevation_deg: float, where: str) -> float:
    """The elevation [degrees] if a barrel can have it."""
    if not LOWEST_ELEVATION <= elevation_deg <= HIGHEST_ELEVATION:
        raise BagError(
            f'{where}: elevation_deg is {elevation_deg:g}: give degrees from '
            f'{LOWEST_ELEVATION:g} to {HIGHEST_ELEVATION:g}')
    return float(elevation_deg)


def same_text(key: str, first: str, second: str) -> bool:
    """Whether two texts of a key state the same of a test."""
    if key == 'elevation_deg':
        one, other = finite_number(first), finite_number(second)
        if one is not None and other is not None:
            return math.isclose(one, other, abs_tol=1e-9)
    if key == 'test':
        return first.lower() == second.lower()
    return first == second


def finite_number(text: str) -> float | None:
    """The number that a text states; None if it states none."""
    try:
        value = plain_number(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
