"""What is doubtful in a record, on its rig, beside other records, or in a driver; in words."""

from saddlering_ros.doubts.comparison import (
    refuse_other_hash,
    refuse_other_rig,
    refuse_parameters_of_other_rig,
    refuse_repeats,
    rig_in_words,
)

__all__ = ['refuse_other_hash', 'refuse_other_rig', 'refuse_parameters_of_other_rig',
           'refuse_repeats', 'rig_in_words']
