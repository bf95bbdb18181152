"""The report of a diagnosis: one HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from saddlering_ros.diagnosis.diagnose import Verdict
from saddlering_ros.report import chapters, html
from saddlering_ros.report.curves import curves_of, RunCurves
from saddlering_ros.report.wording import Document
from saddlering_ros.rig import write_text_atomically


def write_diagnosis_report(verdict: Verdict, path: Path | str) -> None:
    """Write the page of a verdict, whole or not at all."""
    text = diagnosis_page(verdict.to_json(), curves_of(verdict))
    write_text_atomically(Path(path), text)


def diagnosis_page(document: Document, curves: Sequence[RunCurves]) -> str:
    """The page of a verdict's JSON and the curves of its runs."""
    bags = ', '.join(str(run['bag']) for run in document['runs'])
    return html.page('Diagnosis of the ring simulation', [
        '<h1>What the ring simulation gets wrong</h1>', html.paragraph(bags, 'soft'),
        chapters.verdict_banner(document), *diagnosis_chapters(document, curves),
    ])


def diagnosis_chapters(document: Document, curves: Sequence[RunCurves]) -> list[str]:
    """Everything below the verdict, most important first."""
    return [
        chapters.causes(document),
        chapters.misfit(document),
        chapters.paper_split(curves),
        chapters.parameters(document),
        chapters.shape_tests(document),
        chapters.residuals(curves),
        chapters.candidates(document),
        chapters.look_alikes(document),
        chapters.detection_limits(document),
        chapters.notes(document),
    ]
