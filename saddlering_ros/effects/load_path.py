"""Causes between the load cell and the ring: load, angle and height of the loading axis."""

from dataclasses import replace

from saddlering_ros.effects.base import EffectParameter, Outcomes, RingEffect, UNCLEAR
from saddlering_ros.effects.ring_motion import FrictionEffect, LOOP_OUTCOMES, loop_parameters


class LoadGain(RingEffect):
    formula = 'Wrong gain of the load measurement: P = P_m / (1 + g)'
    title = 'Load gain error'
    words = ('The load cell or pressure transducer reads a fixed share too much or too little. '
             'Every displacement changes by that share, so that stiffnesses and dampings imitate '
             'the error completely. Only a reference load, or a stiffness known beforehand, shows '
             'the error.')
    settled_by = ('A reference load: a known weight or a calibrated load cell in line with the '
                  'cylinder.')
    outcomes = Outcomes(
        reference_load='a difference that is a fixed share of the load',
        other_elevation='the same share of every displacement at both elevations')
    stage = 'load path'
    parameters = (EffectParameter(
        'gain', '1', -0.3, 0.3, 0.03, 0.0, 'share by which the measured load is too large',
        amplitude=True, adds_to='load_gain'),)


class LoadOffset(RingEffect):
    formula = 'Wrong zero of the load measurement: P = P_m - P0'
    title = 'Load zero offset'
    words = ('The load measurement does not read zero at zero load. The error is the same number '
             'of newtons in every run, so that it matters most at low load, where the clearances '
             'close.')
    settled_by = 'A zero-load record with the cylinder disconnected, or a reference load.'
    outcomes = Outcomes(
        reference_load='the same difference in newtons at every load', zero_load=UNCLEAR)
    stage = 'load path'
    parameters = (EffectParameter(
        'offset', 'N', -15000.0, 8000.0, 2000.0, 0.0, 'reading of the load measurement at no load',
        amplitude=True, adds_to='load_offset'),)


class LoadNonlinearity(RingEffect):
    formula = 'Bent load characteristic: P = P_m + 4 c P_m (P_fs - P_m) / P_fs'
    title = 'Bent load characteristic'
    words = ('The load measurement is right at zero and at full scale, and wrong between them. '
             'The error is a parabola over load, of equal size in force units in all channels, '
             'up and down alike.')
    settled_by = 'A reference load in several steps up to full scale.'
    outcomes = Outcomes(reference_load='a difference that is largest at half load')
    stage = 'load path'
    parameters = (EffectParameter(
        'curvature', '1', -0.1, 0.1, 0.01, 0.0,
        'largest error, at half load, as a share of full scale', amplitude=True,
        adds_to='load_nonlinearity'),)


class CylinderFriction(FrictionEffect):
    formula = 'Friction in the cylinder: P = P_m - F z, z a hysteron over the measured load'
    title = 'Friction in the hydraulic cylinder'
    words = ('Seals or the rod guide carry a part of the force. The force on the ring is smaller '
             'than measured while loading, and larger while unloading. All displacement channels '
             'show a loop, which has the same height in force units at every load and elevation.')
    settled_by = ('A reference load: a load cell between cylinder and trunnion, read while '
                  'loading and unloading.')
    outcomes = replace(
        LOOP_OUTCOMES,
        reference_load='a difference that changes its sign between loading and unloading')
    element = 'cylinder_friction'
    stage = 'load path'
    form = 0.1  # seals grip harder at rest and at higher pressure
    parameters = (
        EffectParameter('force', 'N', 0.0, 30000.0, 3000.0, 3000.0, 'full friction force',
                        amplitude=True, one_sided=True),
        *loop_parameters('N', 100.0, 20e3, 2e3))


class ElevationError(RingEffect):
    formula = 'Wrong elevation: theta + e'
    title = 'Elevation error'
    words = ('The elevation of the barrel differs from the record. At 50 degrees one degree too '
             'much takes 2.1 % from the radial force and 1.6 % from the moment on the shipped '
             'rig, and adds 1.5 % to the axial force. At 70 degrees it is 4.8, 3.2 and 0.6 %, so '
             'runs at two elevations tell it from a gain.')
    settled_by = 'An inclinometer on the loading axis, read at zero and at full load.'
    outcomes = Outcomes(
        inclinometer='an angle other than the one recorded',
        other_elevation='a misfit whose share of the radial displacement changes '
            'with the elevation')
    stage = 'load path'
    parameters = (EffectParameter(
        'angle', 'rad', -0.1, 0.1, 0.0175, 0.0, 'true elevation minus recorded elevation',
        amplitude=True, adds_to='elevation_error'),)


class MomentArm(RingEffect):
    formula = 'Load applied higher or lower than assumed: y_t + e'
    title = 'Wrong moment arm'
    words = ('The load acts higher or lower over the ring than in the rig file. Only the tilting '
             'moment changes. Tilt changes, and axial motion with it, because the same rows carry '
             'both. The radial channel does not change.')
    settled_by = ('Measure the height of the loading axis over the ring, or hang a reference load '
                  'from a known arm.')
    outcomes = Outcomes(
        heights='another height of the loading axis than in the rig file',
        other_elevation='a misfit of tilt and axial motion only')
    stage = 'load path'
    channels = ('delta_y', 'gamma')
    parameters = (EffectParameter(
        'offset', 'm', -0.3, 0.3, 0.03, 0.0,
        'true height of the trunnion minus the height in the rig file', amplitude=True,
        adds_to='moment_arm'),)


class BracketPlay(FrictionEffect):
    formula = 'Play in the loading bracket: theta + e z, z a hysteron over the measured load'
    title = 'Play in the loading bracket'
    words = ('The bracket or trunnion shifts a little when the load changes direction. The angle '
             'of a rising load therefore differs slightly from that of a falling load. A small '
             'loop results, of opposite sense in the axial channel and in the two others.')
    settled_by = 'An inclinometer on the bracket, read while loading and unloading.'
    outcomes = replace(
        LOOP_OUTCOMES,
        inclinometer='an angle that jumps when the load changes direction')
    element = 'bracket_play'
    stage = 'load path'
    form = 0.1  # a bracket seats bit by bit, not all at one load
    parameters = (
        EffectParameter(
            'angle', 'rad', 0.0, 0.03, 0.003, 0.003,
            'half the play: the angle gained while loading', amplitude=True, one_sided=True),
        *loop_parameters('N', 100.0, 20e3, 2e3))
