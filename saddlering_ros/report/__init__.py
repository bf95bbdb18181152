"""Reports of a ring: figures, tables and one-file HTML pages that show a verdict to a person."""

from saddlering_ros.report.reports import (
    save_plots,
    write_diagnosis_report,
    write_validation_report,
)

__all__ = ['save_plots', 'write_diagnosis_report', 'write_validation_report']
