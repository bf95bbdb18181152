"""What the ring simulation gets wrong in bags: bags and ring joined to the generic engine."""

from saddlering_ros.diagnosis.diagnose import diagnose_bags, DiagnosisError, Verdict

__all__ = ['DiagnosisError', 'Verdict', 'diagnose_bags']
