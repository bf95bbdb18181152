"""Reports: figures, tables and one-file HTML pages that show a verdict to a person."""

from saddlering_ros.report.diagnosis_page import write_diagnosis_report
from saddlering_ros.report.errors import ReportError

__all__ = ['ReportError', 'write_diagnosis_report']
