"""The report of a diagnosis: one HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from saddlering_ros.diagnosis.verdict import Verdict
from saddlering_ros.diagnosis.wording import Document
from saddlering_ros.report import background, chapters, html
from saddlering_ros.report.background import Background, quality_of
from saddlering_ros.report.curves import curves_of, RunCurves
from saddlering_ros.report.curves_file import curves_path, write_curves
from saddlering_ros.report.header import head, head_line
from saddlering_ros.report.proposal import proposal
from saddlering_ros.rig import write_text_atomically

NOTHING = Background()


def write_diagnosis_report(
    verdict: Verdict, path: Path | str, command: str = '',
) -> tuple[Path, Path]:
    """Write the page of a verdict and its curves, whole or not at all; the paths written.

    command: the command line that makes the page.
    """
    known = Background(
        covariance=verdict.extended_parameters().source.covariance,
        quality=[quality_of(figures.record.test_run, verdict.rig) for figures in verdict.runs],
        command=command, curves_file=curves_path(path).name,
        force_unit=verdict.rig.force_unit)
    tests = [head_line(figures.record.test_run, held_out=figures.record.run.held_out)
             for figures in verdict.runs]
    curves = curves_of(verdict)
    top = head(TITLE, verdict.rig, tests)
    write_text_atomically(Path(path), diagnosis_page(verdict.to_json(), curves, known, top))
    write_curves(curves_path(path), curves)
    return Path(path), curves_path(path)


TITLE = 'What the ring simulation lacks'


def diagnosis_page(
    document: Document, curves: Sequence[RunCurves], known: Background = NOTHING,
    top: str = f'<h1>{TITLE}</h1>',
) -> str:
    """The page of a verdict's JSON and the curves of its runs, below a head."""
    return html.page('Diagnosis of the ring simulation', [
        top, chapters.verdict_banner(document, curves),
        *diagnosis_chapters(document, curves, known),
    ])


def diagnosis_chapters(
    document: Document, curves: Sequence[RunCurves], known: Background = NOTHING,
) -> list[str]:
    """Everything below the verdict, most important first."""
    return [
        chapters.causes(document),
        proposal(document, known.force_unit),
        background.misfit_reductions(document),
        chapters.misfit(document),
        chapters.paper_split(curves),
        chapters.residual_map(curves),
        chapters.parameters(document, covariance=known.covariance),
        chapters.candidates(document),
        chapters.shape_tests(document),
        chapters.residuals(curves),
        chapters.look_alikes(document),
        chapters.detection_limits(document),
        background.data_quality(known.quality),
        chapters.notes(document),
        background.reproduction(document, known.command, known.curves_file),
    ]
