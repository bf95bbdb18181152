"""What the ring simulation gets wrong in given bags: bags and ring joined to the generic engine."""

from saddlering_ros.diagnosis.diagnose import DiagnosisError, Verdict, diagnose_bags

__all__ = ['DiagnosisError', 'Verdict', 'diagnose_bags']
