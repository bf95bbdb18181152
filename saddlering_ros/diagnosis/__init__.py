"""The diagnosis of a ring: bags and ring model joined to the generic engine."""

from saddlering_ros.diagnosis.diagnose import diagnose_bags, DiagnosisError, Verdict

__all__ = ['DiagnosisError', 'Verdict', 'diagnose_bags']
