"""Reports: figures, tables and one-file HTML pages that show a verdict to a person."""

from saddlering_ros.report.diagnosis_page import write_diagnosis_report
from saddlering_ros.report.errors import ReportError
from saddlering_ros.report.validation_page import write_validation_report

__all__ = ['ReportError', 'write_diagnosis_report', 'write_validation_report']
