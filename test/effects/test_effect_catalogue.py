"""Claims about the catalogue of effects as a list: complete, readable, and refused in one line."""

import dataclasses
import math
from pathlib import Path
import re
import sys

import pytest

from saddlering_ros import effects, rig
from saddlering_ros.effects import (
    catalogue,
    effect,
    EffectError,
    extension_of,
    NO_EXTENSION,
    RingEffect,
    RingExtension,
    STAGES,
    Variant,
)
from saddlering_ros.effects.extension import shared_parameters
from saddlering_ros.rig import CHANNELS, ParameterSet, read_parameters, TRUE_TO_SCALE

LOAD_PATH = {
    'load_gain', 'load_offset', 'load_nonlinearity', 'cylinder_friction', 'elevation_error',
    'moment_arm', 'bracket_play'}
RING = {
    'radial_friction', 'tilt_friction', 'radial_clearance', 'axial_clearance',
    'radial_compliance', 'tilt_compliance', 'axial_compliance', 'bolt_opening',
    'ring_ovalisation', 'unequal_rows', 'worn_sector_axial', 'worn_sector_radial',
    'out_of_round', 'axial_flatness', 'film_creep', 'settling', 'damping_law',
    'carriage_resonance'}
MEASUREMENT = {
    'probe_height', 'probe_bracket', 'probe_gain', 'probe_nonlinearity', 'probe_drift',
    'probe_lag', 'clock_offset', 'mains_pickup', 'probe_saturation'}
UNITS = {'1', 'N', 'm', 'rad', 'N m', 'm/N', 'rad/(N m)', 's', '1/m', 'm/s', 'Hz'}
EACH = pytest.mark.parametrize('one', catalogue().values(), ids=list(catalogue()))


def typical_values(one: RingEffect, variant: Variant) -> dict[str, float]:
    """Values with every amplitude at its typical size."""
    typical = {p.name: p.scale for p in one.parameters if p.amplitude}
    return one.complete({**variant.values, **typical})


def changed_stages(extension: RingExtension) -> set[str]:
    return {
        field.metadata['stage'] for field in shared_parameters()
        if getattr(extension, field.name) != getattr(NO_EXTENSION, field.name)
    } | {parameter.stage for parameter, _ in extension.own}


def test_the_catalogue_holds_the_agreed_effects() -> None:
    assert set(catalogue()) >= LOAD_PATH | RING | MEASUREMENT


def test_every_effect_stands_in_the_stage_where_its_error_arises() -> None:
    for stage, ids in zip(STAGES, (LOAD_PATH, RING, MEASUREMENT), strict=True):
        assert {effect(name).stage for name in ids} == {stage}


def test_adding_an_effect_is_adding_one_file() -> None:
    folder = Path(effects.__file__).parent
    for one in catalogue().values():
        assert sys.modules[type(one).__module__].__file__ == str(folder / f'{one.id}.py')


def test_the_callers_dictionary_is_their_own() -> None:
    catalogue().clear()
    assert 'load_gain' in catalogue()


@EACH
def test_an_effect_can_be_read_by_a_person(one: RingEffect) -> None:
    assert 1 <= len(one.title.split()) <= 6
    assert 2 <= len(re.findall(r'\.(?= [A-Z]|$)', one.words)) <= 4
    assert one.settled_by.endswith('.')
    assert one.id not in one.words


@EACH
def test_channels_are_known_ones(one: RingEffect) -> None:
    assert one.channels
    assert set(one.channels) <= set(CHANNELS)
    for variant in one.variants:
        assert set(variant.channels) <= set(one.channels)
    assert {name for variant in one.variants for name in variant.channels or one.channels} == set(
        one.channels)


@EACH
def test_the_first_parameter_makes_the_effect_vanish(one: RingEffect) -> None:
    assert one.parameters[0].amplitude


@EACH
def test_bounds_hold_start_neutral_and_typical_size(one: RingEffect) -> None:
    for parameter in one.parameters:
        assert parameter.low < parameter.high
        assert parameter.low <= parameter.start <= parameter.high
        assert 0.0 < parameter.scale <= parameter.high
        assert parameter.words
        assert parameter.unit in UNITS
        if parameter.amplitude:
            assert parameter.low <= parameter.neutral <= parameter.high
            assert abs(parameter.scale - parameter.neutral) > 0.0
        if parameter.one_sided:
            assert parameter.low >= 0.0
        if parameter.logarithmic:
            assert parameter.low > 0.0


@EACH
def test_variants_are_what_the_choices_offer(one: RingEffect) -> None:
    for choice in one.choices:
        assert {variant.values[choice.name] for variant in one.variants} == set(choice.values)
    names = {choice.name for choice in one.choices}
    assert all(set(variant.values) == names for variant in one.variants)
    assert len({variant.label for variant in one.variants}) == len(one.variants)


@EACH
def test_first_guesses_start_within_bounds_and_set_what_they_name(one: RingEffect) -> None:
    for start in one.starts or ({},):
        values = one.complete(start)
        for parameter in one.parameters:
            value = values[parameter.name]
            assert parameter.low <= value <= parameter.high
            assert value == start.get(parameter.name, parameter.start)
    assert len({tuple(sorted(start.items())) for start in one.starts}) == len(one.starts)


def test_effects_whose_misfit_has_several_valleys_have_first_guesses() -> None:
    several = {name for name, one in catalogue().items() if one.starts}
    assert {'bolt_opening', 'out_of_round', 'probe_saturation', 'carriage_resonance'} <= several


@EACH
def test_an_effect_sets_extension_parameters_of_its_own_stage_only(one: RingEffect) -> None:
    for variant in one.variants:
        extension = one.extend(NO_EXTENSION, typical_values(one, variant))
        assert changed_stages(extension) == {one.stage}


def test_effects_can_be_added_in_any_order() -> None:
    together = {one.id: typical_values(one, one.variants[0]) for one in catalogue().values()}
    backwards = dict(reversed(together.items()))
    first, second = extension_of(together), extension_of(backwards)
    for field in dataclasses.fields(first):
        assert getattr(first, field.name) == getattr(second, field.name), field.name


def test_two_effects_on_one_row_both_act() -> None:
    extension = extension_of({
        'radial_clearance': {'change': 2e-5}, 'out_of_round': {'amplitude': 5e-6},
        'worn_sector_radial': {'wear': 0.2}})
    assert extension.radial_row.gap == 1e-5
    assert math.hypot(*extension.radial_row.waves[2:]) == pytest.approx(5e-6)
    assert extension.radial_row.wear.loss == 0.2


def test_no_effects_is_the_plain_model() -> None:
    assert extension_of({}) is NO_EXTENSION


@EACH
def test_an_effect_survives_a_parameter_file(one: RingEffect, tmp_path: Path) -> None:
    values = typical_values(one, one.variants[-1])
    path = tmp_path / 'parameters.yaml'
    rig.write_parameters(path, ParameterSet(TRUE_TO_SCALE, {one.id: values}))
    read = read_parameters(path).effects
    assert extension_of(read) == extension_of({one.id: values})


@pytest.mark.parametrize(('given', 'said'), [
    ({'radial_fricton': {}}, 'radial_friction'),
    ({'xyz': {}}, 'load_gain'),
    ({'load_gain': {'gian': 0.1}}, 'choose from gain'),
    ({'load_gain': {'gain': -1.0}}, 'give a number from -0.3 to 0.3'),
    ({'load_gain': {'gain': math.nan}}, 'give a number'),
    ({'probe_lag': {'time': -0.1}}, 'from 0 to 1 s'),
    ({'probe_gain': {'probe': 0.0}}, 'choose from 1, 2, 3, 4'),
    ({'probe_gain': {'probe': 2.5}}, 'choose from 1, 2, 3, 4'),
    ({'probe_saturation': {'side': 0.0}}, 'choose from 1, -1')])
def test_what_cannot_be_used_is_refused_in_one_line_that_helps(given, said) -> None:
    with pytest.raises(EffectError) as refusal:
        extension_of(given)
    assert said in str(refusal.value)
    assert '\n' not in str(refusal.value)
    assert f'effects.{next(iter(given))}' in str(refusal.value)
