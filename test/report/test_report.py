"""Claims about figures and the one-file page of a verdict."""

import csv
from dataclasses import replace
from pathlib import Path
import re
from types import SimpleNamespace
from unittest import mock

from colour_vision import APART, smallest_difference
from documents import document, record, run_curves
import numpy as np
import pytest
import scipy.signal
from shared_pictures import DRAWN, shared_drawn

from saddlering_ros.diagnosis import ring_wording
from saddlering_ros.diagnosis.ring_wording import document_text, gain_sentence, headline, tried
from saddlering_ros.discrepancy import wording
from saddlering_ros.discrepancy.verdict.wording import change_words, remaining_words
from saddlering_ros.files import write_csv
from saddlering_ros.pages import charts, html
from saddlering_ros.pages.charts import chart_of, draw
from saddlering_ros.pages.html import bars, certainty, MAX_WORDS, pictures_of
from saddlering_ros.quantities import shares_in_words
from saddlering_ros.record.quality import white_noise
from saddlering_ros.report import chapters, figures
from saddlering_ros.report.chapters import proposal
from saddlering_ros.report.figures import branches, curve_columns, curves_path, spectrum
from saddlering_ros.report.reports import date_of, diagnosis_page, head, misfit_reductions
from saddlering_ros.rig import default_rig

RUNS = [run_curves(), run_curves(degrees=70.0, held_out=True), run_curves('dynamic')]


@pytest.fixture(scope='module')
def page(made_once):
    with mock.patch(DRAWN, shared_drawn(made_once)):
        return diagnosis_page(document(), RUNS)


@pytest.mark.filterwarnings('error')
def test_a_sign_that_the_font_lacks_is_drawn_by_another_font_or_as_its_code(tmp_path):
    lacking, in_stix = '\u0378', '\u1d8a'
    names = charts.Ticks((0.0, 1.0), (f'{lacking}_30 µ', in_stix))
    panel = charts.Panel(0, 0, 'x', 'y', (charts.line([0.0, 1.0], [0.0, 1.0], '#000', lacking),),
                         title=lacking, x_ticks=names)
    figure = draw(charts.Chart((panel,), 3.0, 2.0))
    figure.savefig(tmp_path / 'drawn.png')
    axes = figure.axes[0]
    assert axes.get_title() == figure.legends[0].texts[0].get_text() == '\\u0378'
    assert [label.get_text() for label in axes.get_xticklabels()] == ['\\u0378_30 µ', in_stix]


def test_the_page_says_the_verdict_before_anything_else(page):
    text = re.sub(r'<(style|script).*?</\1>', '', page, flags=re.S)
    said = 'The simulation lacks dry friction in the radial row'
    assert text.index(said) < text.index('<section')
    assert '9.000 ± 0.035 kN' in page


def test_the_page_is_one_file_that_fetches_nothing(page):
    text = re.sub(r'<script type="application/octet-stream".*?</script>', '', page, flags=re.S)
    sources = re.findall(r'(?:src|href)="([^"]{0,40})', text)
    assert sources
    for source in sources:
        assert source.startswith(('data:image/png;base64,', 'data:,', '#'))
    assert '@import' not in text
    assert 'url(' not in text


def test_every_picture_of_the_page_is_a_png_with_a_name(page):
    pictures = pictures_of(page)
    assert set(pictures) == {'proof', 'residual_map', 'misfit', 'comparison_static',
                             'comparison_dynamic', 'misfit_static_50', 'misfit_static_70',
                             'misfit_dynamic_50'}
    assert all(data.startswith(b'\x89PNG') for data in pictures.values())


def test_text_from_bags_cannot_break_the_page():
    shown = diagnosis_page(document(notes=['<script>alert(1)</script>']), [])
    assert '<script>alert' not in shown
    assert '&lt;script&gt;' in shown


CHARTS = {
    'comparison': lambda: figures.comparison(RUNS[:2]), 'proof': lambda: figures.proof(
        RUNS[2], 'gamma'), 'residuals': lambda: figures.residuals(RUNS[2]),
    'misfit': lambda: figures.misfit(document()),
    'residual map': lambda: figures.residual_map(RUNS)}


@pytest.mark.parametrize('name', CHARTS)
def test_every_axis_names_what_is_read_off_and_those_at_the_edge_show_it(name):
    chart = CHARTS[name]()
    assert all(panel.x_label and panel.y_label for panel in chart.panels)
    figure = draw(chart)
    bottom = [axes for axes in figure.axes
              if axes.get_subplotspec() is not None and axes.get_subplotspec().is_last_row()
              and not axes.images and axes.get_label() != '<colorbar>']
    assert bool(bottom) == (name != 'residual map')  # which is an image
    assert all(axes.get_xlabel() for axes in bottom)


@pytest.mark.parametrize('chart', [
    lambda run: figures.proof(run, 'delta_x'), lambda run: figures.comparison([run])])
def test_the_whole_legend_of_a_run_is_in_the_picture(chart):
    figure = draw(chart(replace(RUNS[0], sound={'delta_x': 1e-6})))
    figure.draw_without_rendering()
    left, right = figure.legends[0].get_window_extent().intervalx
    assert 0.0 <= left < right <= figure.bbox.width


def test_the_load_of_a_second_cycle_rises_again():
    time = np.arange(0.0, 8.0, 0.01)
    load = 1e5 + 9e4 * np.abs(time % 4.0 - 2.0)  # falls, rises, falls, rises
    run = SimpleNamespace(test='dynamic', path=Path('cycles'), elevation=1.0, time=time, load=load)
    nothing = np.zeros((4, time.size))
    shown = figures.curves_of_run(
        default_rig(), run, nothing, nothing, nothing, {}, held_out=False)
    signs = shown.direction[np.abs(shown.time % 2.0 - 1.0) < 0.5]
    assert np.flatnonzero(np.diff(signs)).size == 3


@pytest.mark.parametrize('name', CHARTS)
def test_picture_and_interactive_figure_show_the_same_data(name):
    chart = CHARTS[name]()
    drawn, seen = draw(chart), chart_of(chart)
    lines = [axes.get_lines() for axes in drawn.axes if axes.get_label() != '<colorbar>']
    series = [item for panel in chart.panels for item in panel.series]
    traces = [item for item in seen['data'] if item['type'] == 'scatter' and item['x'] != [None]]
    assert len(traces) == len(series)
    for item, trace in zip(series, traces, strict=True):
        assert np.allclose(np.array(trace['y'], float), item.y, rtol=1e-6, equal_nan=True)
    levels = sum(len(panel.levels) for panel in chart.panels)
    assert sum(map(len, lines)) == len(series) + levels
    heats = [panel for panel in chart.panels if panel.heat is not None]
    assert sum(item['type'] == 'heatmap' for item in seen['data']) == len(heats)


def test_panels_of_an_interactive_figure_do_not_overlap():
    layout = chart_of(figures.comparison(RUNS[:2]))['layout']
    boxes = [(layout[f'xaxis{n}']['domain'], layout[f'yaxis{n}']['domain'])
             for n in ['', *range(2, 13)]]
    for number, (across, up) in enumerate(boxes):
        for other_across, other_up in boxes[:number]:
            apart = (across[0] >= other_across[1] or across[1] <= other_across[0]
                     or up[0] >= other_up[1] or up[1] <= other_up[0])
            assert apart


def test_none_is_said_plainly_and_without_a_gain():
    said = document('none')
    assert headline(said).startswith('The simulation lacks nothing')
    assert gain_sentence(said) == ''


def test_a_line_beside_a_sound_model_has_no_gain_of_the_model():
    said = {**document('named'), 'gain': {'fit': 0.0, 'held_out': 0.0, 'how': 'none'}}
    assert gain_sentence(said) == ''


@pytest.mark.usefixtures('no_pictures')
def test_a_verdict_without_a_cause_mentions_no_extended_model():
    for verdict in ('none', 'unknown'):
        said = document(verdict, causes=[], notes=[])
        shown = document_text(said) + diagnosis_page(said, RUNS[:1])
        assert 'xtended model' not in re.sub(r'base64,[^"]+|octet-stream.*?</script>', '', shown)
        assert '->' not in document_text(said)


def test_unknown_states_what_was_tried_and_that_no_law_was_found():
    tested = {'effect': 'settling', 'limit': None, 'best_limit': None, 'material_limit': None,
              'unit': 'm', 'share': 0.5, 'testable': False, 'places': []}
    said = document('unknown', causes=[], detection_limits=[tested])
    assert tried(said).startswith('1 cause was compared with the misfit, and ')
    assert 'No law is proposed' in tried(said)
    assert tried(said) in document_text(document('unknown', causes=[], detection_limits=[tested],
                                                 notes=[]))
    assert tried(document('none')) == ''
    assert 'noise alone gives' in headline(said)


def test_what_remains_is_never_nothing():
    assert remaining_words(0.998) == '< 1 % of the power of the misfit beyond noise'
    assert remaining_words(0.88) == '12 % of the power of the misfit beyond noise'
    assert change_words([(-0.16, 'held-out runs'), (0.24, 'fitted runs')]) == (
        'raises the misfit by 16 % on held-out runs, and reduces it by 24 % on fitted runs')
    assert change_words([(0.94, 'held-out runs'), (0.91, 'fitted runs')]) == (
        'reduces the misfit by 94 % on held-out runs, and by 91 % on fitted runs')


def test_ambiguous_names_every_look_alike():
    cause = {**document()['causes'][0], 'group': ['radial_friction', 'settling']}
    said = headline(document('ambiguous', causes=[cause]))
    assert said == ('The simulation lacks either dry friction in the radial row or settling in '
                    'the first cycle (these data cannot tell which).')


def test_unknown_describes_the_shape_that_is_left():
    shape = {'shape': '', 'channel': 'gamma', 'coordinate': 'time', 'p_value': 1e-9,
             'share_of_range': 0.02}
    said = document('unknown', causes=[shape])
    assert 'gamma follows time, 2.0 % of range' in document_text(said)
    assert '. ' not in headline(said)


def test_the_banner_of_unknown_has_one_bold_sentence_and_titles_in_place_of_ids():
    said = document('unknown', probabilities={
        'radial_friction or load_gain': 0.1, 'unknown': 0.9})
    banner = chapters.verdict_banner(said).replace('\xa0', ' ')
    bold, = re.findall(r'<p class="headline">(.*?)</p>', banner)
    assert bold.startswith('Something is wrong')
    assert bold.endswith('noise alone gives 0.20 %.')
    assert re.search('<p>Dry friction .* may explain the misfit, but is not established.</p>',
                     banner)
    assert 'unknown 90 %, dry friction in the radial row or load gain error 10 %.' in banner


REST = {'run': 'static_50', 'channel': 'gamma', 'along': 'load', 'share_of_range': 0.02,
        'times_noise': 3.0}


@pytest.mark.parametrize(('rest', 'changes', 'words'), [
    ([], {}, 'is not established'), ([REST], {}, 'explains only a part of the misfit'),
    ([REST], {'may_be_absent': True},
     'may not be there: the 95 % interval of its size includes its absence')])
def test_a_cause_of_unknown_explains_a_part_only_where_a_rest_is_left(rest, changes, words):
    said = document('unknown', remainder=rest)
    said['causes'] = [{**said['causes'][0], 'partial': True, 'title': 'Dry friction', **changes}]
    text, page = document_text(said), chapters.causes(said).replace('\xa0', ' ')
    assert f'[radial_friction] ({words})' in text
    assert f'{words}.' in text.splitlines()[2]
    assert f'({words})' in page


def test_the_numbers_of_a_cause_say_which_runs_it_predicts():
    said = document(gain={'fit': 0.9, 'held_out': 0.8, 'how': 'held out in turn'})
    page = chapters.causes(said).replace('\xa0', ' ')
    assert 'misfit reduction on runs held out in turn' in page


def test_a_proposed_law_is_shown_with_its_curve_its_worth_and_its_doubts():
    term = {'channel': 'gamma', 'coordinate': 'load', 'law': 'line', 'formula': 'gamma += a P',
            'parameters': {'a': {'value': 2e-10, 'std': 1e-11, 'unit': 'rad/N'}},
            'curve': {'at': [0.0, 1e5, 2e5], 'at_unit': 'N', 'values': [0.0, 2e-5, 4e-5],
                      'std': [0.0, 1e-6, 2e-6], 'unit': 'rad'}}
    law = {**term, 'gain': {'fit': 0.8, 'held_out': 0.7}, 'doubts': ['one rate only'],
           'terms': [term], 'effect_files': ['mine.yaml']}
    shown = proposal(document('unknown', causes=[], proposal=law))
    for words in ('gamma += line in load', '80\u00a0%', '70\u00a0%', 'one rate only', 'mine.yaml'):
        assert words in shown
    assert set(pictures_of(shown)) == {'proposal_1'}
    assert proposal(document()) == ''


def test_half_difference_of_the_branches_is_the_loop_and_nothing_else():
    run = RUNS[0]
    residual = run.residual('delta_x', extended=False)
    _, mean, half_difference = branches(run.load, run.direction, residual)
    assert np.allclose(half_difference, -5e-6, atol=5e-7)
    assert np.allclose(mean, 0.0, atol=5e-7)


@pytest.mark.parametrize(('samples', 'count'), [(1000, 256), (99, 49)])
def test_the_spectrum_is_that_of_welch(samples, count):
    values = np.random.default_rng(1).normal(size=samples)
    frequency, density = spectrum(0.02 * np.arange(samples), values)
    expected = scipy.signal.welch(values, 50.0, nperseg=count)
    assert frequency == pytest.approx(expected[0][1:])
    assert density**2 == pytest.approx(expected[1][1:], rel=1e-9)


def test_a_spectrum_shows_a_tone_at_its_frequency():
    time = np.arange(0.0, 20.0, 0.01)
    frequency, density = spectrum(time, np.sin(2.0 * np.pi * 12.0 * time))
    assert abs(frequency[np.argmax(density)] - 12.0) < 0.5


def test_a_gain_within_the_noise_stands_in_brackets():
    said = document()
    said['runs'][0]['channels']['delta_y'] = {
        'nrmse_before': 3e-3, 'nrmse_after': 6e-3, 'noise_floor': 2e-3}
    shown = misfit_reductions(said)
    assert '(-100 %)' in shown
    assert '>97 %<' in shown


def test_the_head_names_rig_hash_dimensions_and_what_the_bag_states():
    rig = default_rig()
    run = record(details={'operator': 'A. Engineer', 'date': '2026-11-20'})
    shown = head('A title', rig, [(run, 'held out')])
    for words in ('A title', 'SR-017', rig.digest[:12], rig.digest, '2026-11-20', 'third',
                  'A. Engineer', 'held out', '50°', 'axial_rows.pitch_radius', '0.6', '97',
                  '245166.25'):
        assert words in shown
    assert 'operator' not in head('A title', rig, [(record(), 'fitted')])


def test_a_stamp_that_is_no_date_gives_none():
    assert date_of(1_700_000_000_000_000_000) == '2023-11-14 22:13 UTC'
    assert date_of(12_000_000_000) == ''


def test_the_curves_beside_a_report_are_those_that_it_draws(tmp_path):
    path = curves_path(tmp_path / 'page.html')
    write_csv(path, curve_columns(RUNS))
    with path.open(newline='') as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(run.time.size for run in RUNS)
    of_second = [row for row in rows if row['bag'] == 'static_70']
    assert {row['held_out'] for row in of_second} == {'1'}
    assert [float(row['gamma_simulated_extended']) for row in of_second] == list(RUNS[1].after[2])


def test_the_comparison_shows_all_three_displacements():
    labels = {panel.y_label for panel in figures.comparison(RUNS[:2]).panels}
    assert {'δx / µm', 'δy / µm', 'γ / µrad'} <= labels


def test_loads_are_drawn_in_the_unit_of_the_rig_file():
    for unit, peak in (('t', 25.0), ('kN', 245.17)):
        run = replace(RUNS[0], force_unit=unit)
        panel = figures.comparison([run]).panels[-1]
        assert panel.x_label == f'load / {unit}'
        assert max(max(one.x) for one in panel.series) == pytest.approx(peak, rel=1e-3)
        assert figures.residual_map([run]).panels[-1].x_ticks.words[-1].endswith(f' {unit}')


def test_white_noise_is_seen_under_a_curve_and_steps():
    time = np.linspace(0.0, 1.0, 4000)
    noise = np.random.default_rng(3).normal(0.0, 2e-7, time.size)
    steps = 1e-4 * np.sin(3.0 * time) + 1e-5 * np.floor(20.0 * time)
    assert abs(white_noise(steps + noise) / 2e-7 - 1.0) < 0.1


def test_a_page_on_parameters_shows_the_interval_that_was_identified_not_one_of_its_own():
    found = {'evaluations': 10, 'elapsed': 1.0, 'status': 'converged', 'parameters': {
        name: {'value': 1.3e8, 'std': 1e6, 'unit': '1', 'interval': [1.2e8, 1.5e8],
               'reason': None, 'at_bound': False}
        for name in ('K1', 'n1', 'D1', 'K2', 'n2', 'D2')}}
    found['parameters']['n1'] |= {'value': 1.1, 'std': None, 'interval': None, 'reason': 'why'}
    found['parameters']['n2']['value'] = 1.1
    shown = chapters.identified(found)
    assert '(1.2 to 1.5) × 10⁸' in shown
    assert html.pictures_of(shown) == {}
    cells = re.sub(r' (class|data-is)="[^"]*"', '', shown)
    assert '<td>–</td><td>not determined by these data: why</td>' in cells


def test_the_joint_region_is_drawn_with_the_estimate_and_the_intervals_that_are_known():
    region = {'half_axes': [[0.2, 0.02], [0.001, -0.01]],
              'bounds': {'K2': [1e8, 1.4e8], 'n2': [1.0, 1.5]}}
    found = {'joint': {'K2,n2': region}, 'parameters': {
        'K2': {'value': 1.3e8, 'unit': 'N/m^n', 'interval': [1.2e8, 1.5e8]},
        'n2': {'value': 1.1, 'unit': '', 'interval': None}}}
    panel, = figures.joint_regions(found).panels
    outline, interval, estimate = panel.series
    assert outline.x.max() == pytest.approx(1.4e8)
    assert interval.x.tolist() == [1.2e8, 1.5e8]
    assert (estimate.x.tolist(), estimate.y.tolist()) == ([1.3e8], [1.1])


def test_no_interval_and_no_removed_bias_is_printed_for_what_the_data_do_not_determine():
    values = document()['parameters']
    table = chapters.before_and_after(document(parameters={
        **values, 'undetermined': {'after': {'K2': 'no run loads the radial row'}}}))
    row = next(line for line in table.split('<tr>') if '<code>K2</code>' in line)
    assert 'not determined by these data: no run loads the radial row' in row
    assert row.count('>–<') == 3  # interval, bias removed and its ratio


def test_a_page_of_several_chapters_lists_them_with_links(page):
    names = re.findall(r'<section id="([^"]+)">', page)
    links = re.findall(r'<a href="#([^"]+)">', page)
    assert links == names
    assert len(names) == len(set(names)) > 5


def test_a_column_without_a_value_is_left_out():
    shown = html.table(['a', 'empty', html.number('b')], [['1', '', html.number('–')],
                                                          ['2', '–', html.number('3')]])
    assert 'empty' not in shown
    assert '<td class="n none">–</td>' in shown


def test_measured_and_simulated_are_told_apart_in_the_pictures_of_a_validation():
    for run in (RUNS[0], RUNS[2]):
        plain = replace(run, after=run.before)
        over_load, over_time, left = figures.of_run(plain).panels[:3]
        for panel in (over_load, over_time):
            simulated = panel.series[-1]
            for measured in panel.series[:-1]:
                assert measured.colour != simulated.colour
                assert measured.marker or measured.width > simulated.width
        assert left.bands


def test_rising_and_falling_load_are_told_apart_in_static_and_dynamic_tests():
    for run in (RUNS[0], RUNS[2]):
        shown, left = figures.proof(run, 'delta_x').panels
        rising, falling = shown.series[:2]
        assert (rising.name, falling.name) == ('measured, load rising', 'measured, load falling')
        assert rising.colour != falling.colour
        if run.test == 'static':
            assert {'^', 'v'} <= {series.marker for series in left.series}


def test_printed_probabilities_add_to_a_hundred():
    assert shares_in_words({'friction': 0.995, 'none': 0.0, 'unknown': 0.005}) == {
        'friction': '> 99 %', 'unknown': '< 1 %'}
    assert shares_in_words({'a': 1 / 3, 'b': 1 / 3, 'c': 1 / 3}) == {
        'a': '34 %', 'b': '33 %', 'c': '33 %'}
    assert shares_in_words({'a': 1.0, 'none': 0.0}) == {'a': '100 %'}


def test_certainty_is_shown_as_pictures():
    said = document(probabilities={'radial_friction': 0.9, 'none': 0.0, 'unknown': 0.1},
                    stability=0.75, influence=[
                        {'run': 'static_50', 'start': 0.0, 'end': 80.0, 'evidence': 30.0}],
                    remainder=[{'run': 'static_50', 'channel': 'gamma', 'share_of_range': 0.01,
                                'times_noise': 4.0, 'along': 'time', 'size': 3e-6,
                                'unit': 'rad'}],
                    refits=[{'change': 'without a', 'first': 'settling', 'is_same': False}])
    assert set(pictures_of(certainty(said))) == {
        'probabilities', 'refits', 'influence', 'remainder'}
    assert any('static_50, gamma, along time: 3.0 µrad rms, 1.0 % of range, 4 × noise' in line
               for line in wording.certainty_lines(said, ring_wording.lowered_titles))
    assert certainty(document(probabilities={})) == ''


def test_a_long_label_is_broken_in_picture_and_interactive_figure_alike():
    rows = [('probe gain error or probe bracket bends with load or ovalisation: 98 %', 98.0, '')]
    words, = chart_of(bars(rows, 'probability / %'))['layout']['yaxis']['ticktext']
    assert max(map(len, words.split('<br>'))) <= MAX_WORDS


def test_a_verdict_without_causes_shows_one_simulation():
    run = SimpleNamespace(name='a', held_out=False, time=np.arange(4.0), width=np.ones(4),
                          inputs={'load': np.ones(4)}, direction=None)
    shown = SimpleNamespace(
        record=SimpleNamespace(run=run, test_run=record()), channels={}, measured=np.ones((4, 4)),
        before=np.zeros((4, 4)), after=np.zeros((4, 4)))
    fits = SimpleNamespace(before='the fit', after='the same fit, made again')
    verdict = SimpleNamespace(
        runs=[shown], rig=default_rig(), diagnosis=SimpleNamespace(fits=fits, causes=()),
        raceways=())
    assert not figures.curves_of(verdict)[0].is_extended


def test_a_model_with_waves_of_the_raceways_is_not_called_the_contact_law_alone():
    said = document('named', raceways={'upper': 2e-5})
    said['causes'][0]['title'] = 'Dry friction'
    wavy = replace(run_curves(), base=ring_wording.base_words(said['raceways']))
    charts_shown = (figures.misfit(said), figures.comparison([wavy]), figures.residuals(wavy),
                    figures.residual_map([wavy]))
    for place in (document_text(said), chapters.misfit(said),
                  *(str(chart_of(chart)) for chart in charts_shown)):
        assert 'contact law with waves' in place
        assert 'contact law alone' not in place


def test_a_long_row_of_a_table_stands_as_a_list_on_a_phone():
    short = html.table(['a', 'b'], [['1', '2']])
    long = html.table(['a', 'meaning'], [['1', 'a sentence that no phone shows beside others']])
    assert 'class="wide"' not in short
    assert '<td data-is="meaning">a sentence' in long


def test_a_logarithmic_axis_has_a_number_at_each_of_its_ticks():
    axis = chart_of(figures.misfit(document()))['layout']['xaxis']
    assert [float(words) for words in axis['ticktext']] == list(axis['tickvals'])


@pytest.mark.parametrize('pair', [
    (charts.MEASURED, charts.BEFORE), (charts.MEASURED, charts.AFTER),
    (charts.BEFORE, charts.AFTER), (charts.NOISE, charts.BEFORE), (charts.UP, charts.DOWN)])
def test_the_colour_blind_tell_the_curves_of_a_report_apart(pair):
    assert smallest_difference(*pair) >= APART


def test_a_gain_on_runs_held_out_in_turn_is_told_as_such_with_its_cause_too():
    said = document('named')
    told = document_text({
        **said, 'causes': [{**cause, 'title': 'Dry friction'} for cause in said['causes']],
        'gain': {**said['gain'], 'how': 'held out in turn'}})
    assert told.count('runs held out in turn') == 2
    assert 'held-out runs' not in told


def test_the_table_of_next_tests_tells_a_forecast_from_a_refit():
    shared = {'test': 'Record', 'share_alone': 0.79, 'interval_95': [0.7, 0.9], 'share_kept': 1.0}
    table = chapters.simulated_tests({'simulated_tests': [
        {**shared, 'refitted': True}, {**shared, 'refitted': False}]})
    assert [words in table for words in (
        '>79 %<', '>up to 79 %<', '>refits<', '>linear forecast<', 'can promise too much')] == [
        True] * 5
    assert table.count('70 % to 90 %') == 1
