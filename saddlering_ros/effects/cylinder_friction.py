"""Friction in the cylinder: P = P_m - F z, z a hysteron over the measured load."""

from saddlering_ros.effects.base import EffectParameter, FrictionEffect, loop_parameters


class CylinderFriction(FrictionEffect):
    title = 'Friction in the hydraulic cylinder'
    words = ('Seals or the rod guide carry a part of the force. The force on the ring is smaller '
             'than measured while loading, and larger while unloading. All displacement channels '
             'show a loop, which has the same height in force units at every load and elevation.')
    settled_by = ('A reference load: a load cell between cylinder and trunnion, read while '
                  'loading and unloading.')
    outcomes = {
        **FrictionEffect.outcomes,
        'reference_load': 'a difference that changes its sign between loading and unloading'}
    element = 'cylinder_friction'
    stage = 'load path'
    form = 0.1  # seals grip harder at rest and at higher pressure
    parameters = (
        EffectParameter('force', 'N', 0.0, 30000.0, 3000.0, 3000.0, 'full friction force',
                        amplitude=True, one_sided=True),
        *loop_parameters('N', 100.0, 20e3, 2e3))
