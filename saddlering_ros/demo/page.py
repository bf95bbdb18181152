"""The demo's report: the verdict first, then the steps, then the chapters of a diagnosis."""

from __future__ import annotations

from saddlering_ros.demo import figures
from saddlering_ros.demo.story import DemoOutcome
from saddlering_ros.pages import html
from saddlering_ros.pages.html import Cell, number
from saddlering_ros.quantities import percent
from saddlering_ros.report import background, chapters, parameters
from saddlering_ros.report.background import quality_of

FOUND_BY = ('The result of /identify_ring, before the diagnosis. The missing cause biases these '
            'contact parameters.')


def demo_page(outcome: DemoOutcome, command: str) -> str:
    """The whole page; `command` is the command line that makes it again."""
    document = outcome.verdict.copy()
    document['runs'] = figures.misfit_table(outcome.curves)
    return html.page('saddlering demo', [
        '<h1>From recorded bags to a named cause</h1>',
        html.paragraph(_lead(outcome), 'soft'),
        chapters.verdict_banner(document, outcome.curves),
        _tiles(outcome),
        chapters.paper_split(outcome.curves),
        chapters.misfit(document),
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
        background.data_quality([quality_of(run, outcome.rig) for run in outcome.plan.runs]),
        chapters.notes(outcome.verdict),
        background.reproduction(outcome.verdict, command),
    ])


def _lead(outcome: DemoOutcome) -> str:
    first, second = outcome.plan.identify, outcome.plan.verify
    return (f'Identified from {", ".join(run.path.name for run in first)}; verified on '
            f'{", ".join(run.path.name for run in second)}, which were held out. All bags were '
            'replayed to live ROS 2 nodes, and an ordinary client called both actions.')


def _tiles(outcome: DemoOutcome) -> str:
    before, after = (figures.overall(outcome.verified, extended=item) for item in (False, True))
    messages = sum(item.messages for item in outcome.replays)
    lost = sum(item.lost for item in outcome.replays)
    return html.tiles([
        (percent(before), 'misfit of held-out runs, contact law alone'),
        (percent(after), 'with the extended model, replayed again'),
        (percent(outcome.gain), 'misfit reduction measured live'),
        (f'{messages:,}'.replace(',', ' '), 'messages received live, '
         + (f'{lost} lost' if lost else 'none lost')),
        (f'{outcome.seconds:.0f} s', 'for the whole demonstration'),
    ])


def _replays(outcome: DemoOutcome) -> str:
    rows: list[list[str | Cell]] = [[
        item.bag, item.parameters, number(str(item.messages)), number(f'{item.seconds:.1f}'),
        number(f'{item.speed:.2g}')] for item in outcome.replays]
    return html.section('Replays', html.table(
        ['bag', 'simulated with', number('messages received'), number('seconds'),
         number('times real time')], rows,
        'In lockstep: the clock waits until every node has processed all messages.'))
