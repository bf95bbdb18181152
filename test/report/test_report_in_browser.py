"""Claims about a report as a browser shows it: offline, without errors, to zoom into, to print."""

from unittest import mock

from browser import browser_page
from documents import document, record, run_curves
import numpy as np
import pytest
from shared_pictures import DRAWN, shared_drawn

from saddlering_ros.files import Origin, Provenance
from saddlering_ros.report.reports import data_quality, diagnosis_page
from saddlering_ros.rig import default_rig

HASH = 64 * 'a'
COMMAND = 'saddlering diagnose static_50 --report page.html'


def whole_page():
    alike = {**document()['causes'][0], 'group': ['radial_friction', 'settling']}
    made = Provenance((Origin('static_50', HASH),), versions={'saddlering_ros': '0.1.0'})
    said = document('ambiguous', causes=[alike], next_test='Load twice as fast.',
                    provenance=made.as_dict())
    covariance = np.diag([1e12, 1e-4, 1e9, 1e12, 1e-4, 1e9])
    covariance[0, 1] = covariance[1, 0] = -0.95e4
    return diagnosis_page(said, [run_curves(), run_curves(degrees=70.0, held_out=True)],
                          covariance, quality=data_quality([record()], default_rig()),
                          command=COMMAND)


@pytest.fixture(scope='module')
def page(tmp_path_factory, made_once):
    file = tmp_path_factory.mktemp('report') / 'page.html'
    with mock.patch(DRAWN, shared_drawn(made_once)):
        file.write_text(whole_page(), encoding='utf-8')
    with browser_page() as tab:
        tab.open(file.as_uri())
        tab.wait('document.documentElement.dataset.charts === "ready"')
        tab.run('document.querySelectorAll("details").forEach((it) => { it.open = true; })')
        tab.moved = moved_while_drawn(tab, 'document.querySelectorAll("figure")[2]')
        for place in range(tab.run('document.querySelectorAll("figure").length')):
            figure = f'document.querySelectorAll("figure")[{place}]'
            # A reader keeps in view what is to be drawn.
            tab.wait(f'{figure}.scrollIntoView(), {figure}.classList.contains("drawn")')
        yield tab


def moved_while_drawn(tab, figure):
    """How far a figure moved on the screen from its picture to its plot [px]."""
    tab.run(f'{figure}.scrollIntoView()')
    tab.wait(f'{figure}.classList.contains("drawn")')
    return tab.run(f'{figure}.getBoundingClientRect().top')


def test_a_figure_that_is_drawn_stays_where_it_was_on_the_screen(page):
    assert page.moved == pytest.approx(0.0, abs=2.0)


def test_it_opens_without_errors_and_asks_nobody_for_anything(page):
    assert page.errors == []
    assert [url for url in page.requests if not url.startswith(('data:', 'file:'))] == []
    assert sum(url.startswith('file:') for url in page.requests) == 1


@pytest.mark.parametrize('figure', [
    'these data cannot tell which', '9.000 ± 0.035 kN', 'Load twice as fast.',
    'alternatives for these data', '97 %', '−0.95', '1 (≤ 3 s)', 'a note', HASH, COMMAND,
    'chosen: it explains most', '(1.275 to 1.326) × 10⁸'])
def test_what_matters_stands_there_as_text(page, figure):
    assert figure in page.text()


def test_the_picture_that_proves_it_stands_beside_the_verdict(page):
    assert page.run('document.querySelector(".verdict figure .plot") !== null')


def test_dragging_over_a_figure_zooms_into_it_and_pictures_give_way(page):
    assert page.run('getComputedStyle(document.querySelector("figure.drawn img")).display') == (
        'none')
    page.run('document.querySelector(".verdict .plot").scrollIntoView()')
    box = page.run('document.querySelector(".verdict .nsewdrag").getBoundingClientRect().toJSON()')
    before = page.run('document.querySelector(".verdict .plot")._fullLayout.xaxis.range')
    y = box['y'] + 0.5 * box['height']
    for kind, share in (('mousePressed', 0.3), ('mouseMoved', 0.5), ('mouseReleased', 0.6)):
        page.send('Input.dispatchMouseEvent', type=kind, x=box['x'] + share * box['width'], y=y,
                  button='left', buttons=1, clickCount=1)
    after = page.wait('(() => { const range = document.querySelector(".verdict .plot")._fullLayout'
                      f'.xaxis.range; return range[0] > {before[0]} + 1 && range; }})()')
    assert after[1] < before[1]


def test_it_fits_any_screen_can_be_read_and_is_reached_by_the_keyboard(page):
    assert page.unfit_for_people() == []


def test_a_table_copies_as_a_table(page):
    copied = page.run("""(() => {
        const all = document.createRange();
        all.selectNode([...document.querySelectorAll('table')].find(
            (it) => it.innerText.includes('misfit reduction in')));
        getSelection().removeAllRanges();
        getSelection().addRange(all);
        return getSelection().toString(); })()""")
    rows = [line.split('\t') for line in copied.strip().splitlines() if '\t' in line]
    assert ['static_50', 'fitted', '97 %', '97 %', '97 %', '–'] in [
        [cell.strip() for cell in row] for row in rows]


def test_no_table_that_fits_on_a_page_is_split_in_print(page):
    page.send('Emulation.setEmulatedMedia', media='print')
    kept = page.run('[...document.querySelectorAll("table")].every((it) => '
                    'getComputedStyle(it).breakInside === "avoid")')
    page.send('Emulation.setEmulatedMedia', media='')
    assert kept


def test_it_prints_with_pictures_and_everything_unfolded(page):
    page.send('Emulation.setEmulatedMedia', media='print')
    shown = page.run('[...document.querySelectorAll("figure")].every((it) => '
                     'getComputedStyle(it.querySelector("img")).display !== "none" && '
                     'getComputedStyle(it.querySelector(".plot")).display === "none")')
    page.send('Emulation.setEmulatedMedia', media='')
    assert shown
    assert page.printed().startswith(b'%PDF')


def test_it_prints_on_at_most_twelve_pages(page):
    assert 1 < page.printed().count(b'/Type /Page\n') <= 12


def test_a_phone_shows_it_without_scrolling_to_the_side(page):
    page.send('Emulation.setDeviceMetricsOverride', width=390, height=844, deviceScaleFactor=1,
              mobile=True)
    wide = page.run('[...document.querySelectorAll("main > *")].filter((it) => '
                    'it.getBoundingClientRect().right > 391).length')
    tables = page.run('[...document.querySelectorAll("table.wide")].filter((it) => '
                      'it.scrollWidth > 391).length')
    page.send('Emulation.clearDeviceMetricsOverride')
    assert (wide, tables) == (0, 0)
