"""Claims about numbers as a person reads them."""

import math

import pytest

from saddlering_ros.errors import counted
from saddlering_ros.quantities import compact, percent, probability, quantity, signed, span


@pytest.mark.parametrize(('value', 'unit', 'std', 'shown'), [
    (9037.0, 'N', 35.0, '9.037 ± 0.035 kN'),
    (1.9855e-6, 'm', 3.5e-8, '1.986 ± 0.035 µm'),
    (1.1111, '1', 0.0013, '1.1111 ± 0.0013'),
    (1.29e8, 'N/m^n', 1.6e6, '(1.290 ± 0.016) × 10⁸ N/m^n'),
    (0.004, 's', None, '4.00 ms'),
    (0.5, '', None, '0.500'),
    (math.radians(2.0), 'rad', None, '2.00 °'),
    (0.0, 'N', None, '0 N'),
    (1200.0, 's', None, '20.0 min'), (7200.0, 's', None, '2.00 h'), (4e6, 's', None, '46.3 d')])
def test_a_quantity_has_a_prefix_and_the_digits_its_error_leaves(value, unit, std, shown):
    assert quantity(value, unit, std) == shown


def test_one_thing_is_in_the_singular_with_its_verb():
    assert [counted(number, 'gap') for number in (0, 1, 2)] == ['0 gaps', '1 gap', '2 gaps']
    assert [counted(number, 'stamp goes|stamps go') for number in (1, 2)] == [
        '1 stamp goes', '2 stamps go']


def test_an_interval_has_one_power_of_ten_and_its_unit():
    assert span(1.27e8, 1.33e8, 'N/m^n') == '(1.27 to 1.33) × 10⁸ N/m^n'
    assert span(1.065, 1.0967) == '1.065 to 1.097'
    assert span(1700000005.0125, 1700000007.5, 's', 3) == '1700000005 to 1700000008 s'
    assert span(1.27, 1.2701) == '1.27 to 1.2701'


def test_a_compact_number_has_no_closing_zeros_and_no_letter_e():
    assert [compact(value) for value in (2e4, 2e7, 0.5, 1e-6)] == [
        '20000', '2 × 10⁷', '0.5', '1 × 10⁻⁶']


def test_a_signed_quantity_shows_both_signs():
    assert signed(3.2e-6, 'm') == '+3.20 µm'
    assert signed(-3.2e-6, 'm') == '-3.20 µm'


@pytest.mark.parametrize('value', [None, math.nan, math.inf])
def test_what_is_no_number_is_a_dash(value):
    assert quantity(value, 'm') == percent(value) == probability(value) == '–'


def test_a_percentage_keeps_two_digits_and_does_not_pretend_below_a_thousandth():
    assert percent(0.0614) == '6.1 %'
    assert percent(0.00123) == '0.12 %'
    assert percent(1e-9) == '< 0.001 %'


def test_a_probability_too_small_to_matter_is_only_called_small():
    assert probability(1e-300) == '< 10⁻¹²'
    assert probability(0.5) == '0.50'
