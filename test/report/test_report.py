"""Claims about figures and the one-file page of a verdict."""

import re

from documents import document, run_curves
import numpy as np
import pytest

from saddlering_ros.report import figures
from saddlering_ros.report.curves import branches, spectrum
from saddlering_ros.report.diagnosis_page import diagnosis_page
from saddlering_ros.report.html import pictures_of
from saddlering_ros.report.wording import gain_sentence, headline

RUNS = [run_curves(), run_curves(degrees=70.0, held_out=True), run_curves('dynamic')]


@pytest.fixture(scope='module')
def page():
    return diagnosis_page(document(), RUNS)


def test_the_page_says_the_verdict_before_anything_else(page):
    text = re.sub(r'<style>.*?</style>', '', page, flags=re.S)
    said = 'The simulation lacks dry friction in the radial row'
    assert text.index(said) < text.index('<section')
    assert '9.000 ± 0.035 kN' in page


def test_the_page_is_one_file_that_fetches_nothing(page):
    for source in re.findall(r'(?:src|href)="([^"]{0,40})', page):
        assert source.startswith('data:image/png;base64,')
    assert '<script' not in page
    assert '@import' not in page
    assert 'url(' not in page


def test_every_picture_of_the_page_is_a_png_with_a_name(page):
    pictures = pictures_of(page)
    assert set(pictures) == {'misfit', 'comparison_static', 'comparison_dynamic', 'look_alikes',
                             'misfit_static_50', 'misfit_static_70', 'misfit_dynamic_50'}
    assert all(data.startswith(b'\x89PNG') for data in pictures.values())


def test_text_from_bags_cannot_break_the_page():
    shown = diagnosis_page(document(notes=['<script>alert(1)</script>']), [])
    assert '<script' not in shown
    assert '&lt;script&gt;' in shown


@pytest.mark.parametrize('draw', [
    lambda: figures.comparison(RUNS[:2]), lambda: figures.residuals(RUNS[2]),
    lambda: figures.misfit(document()['runs']),
    lambda: figures.look_alikes(document()['signature_cosines']),
], ids=['comparison', 'residuals', 'misfit', 'look-alikes'])
def test_every_axis_at_the_edge_of_a_figure_is_labelled(draw):
    figure = draw()
    labelled = [axes for axes in figure.axes if axes.get_xlabel() or axes.get_ylabel()
                or axes.get_title() or axes.get_yticklabels()]
    assert labelled
    bottom = [axes for axes in figure.axes
              if axes.get_subplotspec() is not None and axes.get_subplotspec().is_last_row()
              and not axes.images and axes.get_label() != '<colorbar>']
    assert all(axes.get_xlabel() for axes in bottom)


def test_none_is_said_plainly_and_without_a_gain():
    said = document('none')
    assert headline(said).startswith('The simulation lacks nothing')
    assert gain_sentence(said) == ''


def test_ambiguous_names_every_look_alike():
    cause = {**document()['causes'][0], 'group': ['radial_friction', 'settling']}
    said = headline(document('ambiguous', causes=[cause]))
    assert 'cannot tell which' in said
    assert 'dry friction in the radial row' in said
    assert ' or ' in said


def test_unknown_describes_the_shape_that_is_left():
    shape = {'shape': '', 'channel': 'gamma', 'coordinate': 'time', 'p_value': 1e-9,
             'share_of_range': 0.02}
    said = headline(document('unknown', causes=[shape]))
    assert 'gamma follows time, 2.0 % of range' in said


def test_half_difference_of_the_branches_is_the_loop_and_nothing_else():
    run = RUNS[0]
    found = branches(run.load, run.direction, run.residual('delta_x', extended=False))
    assert np.allclose(found.half_difference, -5e-6, atol=5e-7)
    assert np.allclose(found.mean, 0.0, atol=5e-7)


def test_a_spectrum_shows_a_tone_at_its_frequency():
    time = np.arange(0.0, 20.0, 0.01)
    frequency, density = spectrum(time, np.sin(2.0 * np.pi * 12.0 * time))
    assert abs(frequency[np.argmax(density)] - 12.0) < 0.5
