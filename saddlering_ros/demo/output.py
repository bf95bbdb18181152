"""Output of the demo: its report, pictures, numbers and parameter files, all or none."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from saddlering_ros.demo.live import DemoError
from saddlering_ros.demo.story import DemoOutcome, misfit_table, overall_misfit
from saddlering_ros.files import temporary_folder
from saddlering_ros.pages import html
from saddlering_ros.pages.html import number, pictures_of
from saddlering_ros.quantities import percent
from saddlering_ros.report import background, chapters, parameters
from saddlering_ros.rig import write_parameters
from saddlering_ros.ros.launcher import signals_held


def check_folder(folder: Path) -> None:
    """DemoError if the folder cannot be written; checked before the work."""
    if folder.exists() and not folder.is_dir():
        raise DemoError(f'{folder}: is not a folder: choose another place (--out)')
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not os.access(there, os.W_OK | os.X_OK):
        raise DemoError(f'{there}: cannot be written to: choose another place (--out)')


def write_all(outcome: DemoOutcome, folder: Path, command: str) -> list[Path]:
    """Write everything beside `folder` first, then move it in, at one go; the paths.

    `command` is the command line that makes the report again.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        with temporary_folder(folder.parent, f'.{folder.name}.') as staging:
            page = demo_page(outcome, command)
            (staging / 'report.html').write_text(page, encoding='utf-8')
            for name, data in pictures_of(page).items():
                (staging / f'{name}.png').write_bytes(data)
            numbers = json.dumps(numbers_of(outcome), indent=2)
            (staging / 'numbers.json').write_text(numbers + '\n', encoding='utf-8')
            write_parameters(staging / 'parameters_identified.yaml', outcome.identified)
            write_parameters(staging / 'parameters_extended.yaml', outcome.extended)
            files = sorted(staging.iterdir())
            with signals_held():  # Ctrl-C waits until the files are in place
                folder.mkdir(exist_ok=True)
                for file in files:
                    file.replace(folder / file.name)
        return [folder / file.name for file in files]
    except OSError as problem:
        raise DemoError(f'{folder}: cannot be written ({problem.strerror}): choose another place '
                        '(--out)') from problem


def numbers_of(outcome: DemoOutcome) -> dict[str, Any]:
    """All numbers of the demo, for a program."""
    return {
        'bags': {'identify': [run.path.name for run in outcome.plan.identify],
                 'verify': [run.path.name for run in outcome.plan.verify]},
        'identification': outcome.identification,
        'verdict': outcome.verdict,
        'live': {
            'replays': [vars(item) for item in outcome.replays],
            'runs': misfit_table(outcome.curves),
            'gain': outcome.gain,
        },
        'seconds': outcome.seconds,
    }


FOUND_BY = ('The result of /identify_ring, before the diagnosis. The missing cause biases these '
            'contact parameters.')


def demo_page(outcome: DemoOutcome, command: str) -> str:
    """The whole page; `command` is the command line that makes it again."""
    document = outcome.verdict.copy()
    document['runs'] = misfit_table(outcome.curves)
    return html.page('saddlering demo', [
        '<h1>From recorded bags to a named cause</h1>',
        html.paragraph(_lead(outcome), 'soft'),
        chapters.verdict_banner(document, outcome.curves),
        _tiles(outcome),
        html.paragraph('Misfits on this page are those of the replays. They count from the zero '
                       'of the live nodes. The diagnosis also fits a constant offset of each '
                       'probe, so that the misfits it prints are smaller.', 'note'),
        chapters.paper_split(outcome.curves),
        chapters.misfit(document, chapters.FROM_ZERO),
        background.misfit_reductions(document),
        chapters.causes(outcome.verdict),
        parameters.identified(outcome.identification, FOUND_BY),
        parameters.before_and_after(outcome.verdict, 'without the cause', 'with it',
                            outcome.extended.source.covariance),
        chapters.residual_map(outcome.curves),
        chapters.residuals(outcome.curves),
        chapters.shape_tests(outcome.verdict),
        chapters.candidates(outcome.verdict),
        chapters.look_alikes(outcome.verdict),
        chapters.detection_limits(outcome.verdict),
        _replays(outcome),
        background.data_quality(outcome.plan.runs, outcome.rig),
        chapters.notes(outcome.verdict),
        background.reproduction(outcome.verdict, command),
    ])


def _lead(outcome: DemoOutcome) -> str:
    first, second = outcome.plan.identify, outcome.plan.verify
    return (f'Identified from {", ".join(run.path.name for run in first)}; verified on '
            f'{", ".join(run.path.name for run in second)}, which were held out. All bags were '
            'replayed to live ROS 2 nodes, and an ordinary client called both actions.')


def _tiles(outcome: DemoOutcome) -> str:
    before, after = (overall_misfit(outcome.verified, extended=item) for item in (False, True))
    messages = sum(item.messages for item in outcome.replays)
    lost = sum(item.lost for item in outcome.replays)
    return html.tiles([
        (percent(before), 'misfit of held-out runs, contact law alone'),
        (percent(after), 'with the extended model, replayed again'),
        (percent(outcome.gain), 'misfit reduction measured live'),
        (f'{messages:,}'.replace(',', ' '), 'messages received live, '
         + (f'{lost} more were published and not received' if lost else 'none lost')),
        (f'{outcome.seconds:.0f} s', 'for the whole demonstration'),
    ])


def _replays(outcome: DemoOutcome) -> str:
    rows = [[item.bag, item.parameters, str(item.messages), str(item.lost or '–'),
             f'{item.seconds:.1f}', f'{item.speed:.2g}'] for item in outcome.replays]
    return html.section('Replays', html.table(
        ['bag', 'simulated with', *map(number, (
            'messages received', 'not received', 'seconds', 'times real time'))], rows,
        'In lockstep: the clock waits until every node has processed all messages.'))
