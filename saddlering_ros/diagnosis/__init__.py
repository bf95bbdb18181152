"""The diagnosis of a ring: runs and ring model joined to the generic engine."""

from saddlering_ros.diagnosis.records import DiagnosisError
from saddlering_ros.diagnosis.ring_diagnosis import diagnose_ring
from saddlering_ros.diagnosis.verdict import Verdict

__all__ = ['DiagnosisError', 'Verdict', 'diagnose_ring']
