"""Results compacted: Parquet of verdicts, parameters and detection limits, and the fleet's files.

Results are read one at a time and written in groups of rows, so that memory does not grow with
the number of sessions.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime, timezone
from itertools import islice
import json
from typing import Any

import pyarrow
import pyarrow.parquet

from saddlering_ros.campaign.store import CampaignError, Store
from saddlering_ros.campaign.task import SessionTask
from saddlering_ros.files import whole_file, write_text
from saddlering_ros.fleet.attention import Fleet, fleet_document, fleet_page, judge_fleet
from saddlering_ros.fleet.statistics import figures_of

GROUP = 500
"""Sessions whose rows are held in memory at a time."""

_TEXT, _NUMBER = pyarrow.string(), pyarrow.float64()
_SESSION = [
    ('key', _TEXT), ('session', _TEXT), ('ring', _TEXT), ('bench', _TEXT),
    ('time', pyarrow.timestamp('ms', tz='UTC')), ('service_hours', _NUMBER)]
_CAUSE = pyarrow.struct([
    ('effect', _TEXT), ('group', pyarrow.list_(_TEXT)), ('size', _NUMBER), ('std', _NUMBER),
    ('unit', _TEXT), ('p_value', _NUMBER), ('misfit_reduction', _NUMBER),
    ('misfit_reduction_held_out', _NUMBER), ('partial', pyarrow.bool_())])
VERDICTS = pyarrow.schema([
    *_SESSION, ('maintenance', pyarrow.bool_()), ('status', _TEXT), ('kind', _TEXT),
    ('reason', _TEXT), ('verdict', _TEXT), ('causes', pyarrow.list_(_CAUSE)),
    ('p_value', _NUMBER), ('misfit_reduction', _NUMBER), ('misfit_reduction_held_out', _NUMBER),
    ('change', _TEXT), ('change_headline', _TEXT), ('change_causes', pyarrow.list_(_CAUSE)),
    ('next_test', _TEXT), ('report', _TEXT), ('bags', pyarrow.list_(_TEXT)),
    ('bag_sha256', pyarrow.list_(_TEXT)), ('rig_file', _TEXT), ('rig_sha256', _TEXT),
    ('code', _TEXT), ('seed', pyarrow.int64()), ('seconds', _NUMBER)])
PARAMETERS = pyarrow.schema([
    *_SESSION, ('parameter', _TEXT), ('value', _NUMBER), ('std', _NUMBER),
    ('covariance', pyarrow.list_(_NUMBER))])
LIMITS = pyarrow.schema([
    *_SESSION, ('effect', _TEXT), ('limit', _NUMBER), ('material_limit', _NUMBER),
    ('unit', _TEXT), ('testable', pyarrow.bool_())])

def results_of(store: Store,
               tasks: Iterable[SessionTask]) -> Iterator[tuple[SessionTask, dict[str, Any]]]:
    """The tasks that have a result, each with it, one at a time.

    Names, rings and times are the tasks' own: a result does not depend on them.
    """
    for task in tasks:
        result = store.read_result(task.key)
        if result is not None:
            yield task, result


def write_tables(store: Store, tasks: Sequence[SessionTask]) -> None:
    """verdicts.parquet, parameters.parquet and detection_limits.parquet, each whole or not."""
    for name, schema in (
            ('verdicts', VERDICTS), ('parameters', PARAMETERS), ('detection_limits', LIMITS)):
        rows = ({**_session(task), **row} for task, result in results_of(store, tasks)
                for row in _rows(task, result)[name])
        with whole_file(store.folder / f'{name}.parquet', CampaignError) as temporary, \
                pyarrow.parquet.ParquetWriter(temporary, schema) as writer:
            while group := list(islice(rows, GROUP)):
                writer.write_table(pyarrow.Table.from_pylist(group, schema=schema))


def _session(task: SessionTask) -> dict[str, Any]:
    """The columns that all tables share."""
    time = task.time
    return {
        'key': task.key, 'session': task.name, 'ring': task.ring, 'bench': task.bench,
        'time': None if time is None else datetime.fromtimestamp(time, timezone.utc),
        'service_hours': task.service_hours}


def _rows(task: SessionTask, result: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """The rows of a session by table; a failed one has a row without a verdict."""
    document = result.get('verdict') or {}
    gain, change = document.get('gain') or {}, result.get('change') or {}
    verdict = {
        'maintenance': task.maintenance, 'status': result['status'], 'kind': result.get('kind'),
        'reason': result.get('reason'), 'verdict': document.get('verdict'),
        'causes': [_cause(cause) for cause in document.get('causes', [])],
        'p_value': p_value_of(document) if document else None,
        'misfit_reduction': gain.get('fit'), 'misfit_reduction_held_out': gain.get('held_out'),
        'change': change.get('verdict'), 'change_headline': change.get('headline'),
        'change_causes': [_cause(cause) for cause in change.get('causes', [])],
        'next_test': document.get('next_test'), 'report': result.get('report') or None,
        'bags': [bag.path for bag in task.bags],
        'bag_sha256': [bag.sha256 for bag in task.bags],
        'rig_file': task.rig or None, 'rig_sha256': task.rig_sha256 or None,
        'code': (result.get('versions') or {}).get('code'), 'seed': result['seed'],
        'seconds': result['seconds']}
    after = (document.get('parameters') or {}).get('after') or {}
    names = [name for name in after if not name.endswith('_std')]
    # The covariance of a parameter is the row of the session's matrix.
    covariance = result.get('covariance') or [[None] * len(names)] * len(names)
    parameters = [{'parameter': name, 'value': after[name], 'std': after.get(f'{name}_std'),
                   'covariance': list(covariance[row])} for row, name in enumerate(names)]
    # An effect of the catalogue each: the size that this session could have shown.
    limits = [{name: limit.get(name) for name in LIMITS.names[len(_SESSION):]}
              for limit in document.get('detection_limits') or []]
    return {'verdicts': [verdict], 'parameters': parameters, 'detection_limits': limits}


def _cause(cause: Mapping[str, Any]) -> dict[str, Any]:
    name, gain = cause.get('effect'), cause.get('gain') or {}
    size: Mapping[str, Any] = next(iter((cause.get('parameters') or {}).values()), {})
    return {
        'effect': name or cause.get('shape'), 'group': cause.get('group') or [],
        'size': size.get('value'), 'std': size.get('std'), 'unit': size.get('unit'),
        'p_value': (cause.get('evidence') or cause).get('p_value'),
        'misfit_reduction': gain.get('fit'), 'misfit_reduction_held_out': gain.get('held_out'),
        'partial': bool(cause.get('partial', name is None))}


def p_value_of(document: Mapping[str, Any]) -> float:
    """Chance that a sound ring gives so strong a finding; 1 where nothing material was found.

    The engine's p-values count all effects tried, so that one of a session needs no correction.
    """
    if document.get('verdict') in (None, 'none'):
        return 1.0
    p_values = [(cause.get('evidence') or cause).get('p_value') for cause in document['causes']]
    return min([float(value) for value in p_values if value is not None], default=1.0)


def write_fleet(store: Store, tasks: Sequence[SessionTask], limits: Mapping[str, float]) -> Fleet:
    """Judge the fleet of the sessions that have a verdict; write fleet.json and report.html."""
    figures, failures = [], []
    for task, result in results_of(store, tasks):
        if result['status'] == 'failed':
            failures.append((task.name, str(result['reason'])))
        else:
            figures.append(figures_of(task.as_dict(), result, p_value_of(result['verdict'])))
    fleet = judge_fleet(figures, limits)
    document = {**fleet_document(fleet), 'failures': [
        {'session': name, 'reason': reason} for name, reason in failures]}
    write_text(store.folder / 'fleet.json', json.dumps(document, indent=1) + '\n', CampaignError)
    write_text(store.folder / 'report.html', fleet_page(fleet, failures), CampaignError)
    return fleet
