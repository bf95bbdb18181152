"""Results of the computations as objects that print, plot and save."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
import json
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np

from saddlering_ros import files
from saddlering_ros.api import inputs
from saddlering_ros.api.inputs import ApiError, Bag, Columns, columns_of, runs_of, Tabular
from saddlering_ros.diagnosis import Verdict
from saddlering_ros.diagnosis.ring_wording import causes_of, document_text, VerdictDocument
from saddlering_ros.errors import counted
from saddlering_ros.identification.result import FittedLaw, Identification, identification_text
from saddlering_ros.identification.validation import Criterion, judge, Validation, validation_text
from saddlering_ros.quantities import verdict_line
from saddlering_ros.rig import write_parameters

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from saddlering_ros.comparison.change import Change
    from saddlering_ros.files import Origin
    from saddlering_ros.pages.charts import Chart
    from saddlering_ros.report.figures import RunCurves
    from saddlering_ros.rig import ParameterSet, Rig

CAUSE_COLUMNS = ('cause', 'title', 'parameter', 'value', 'std', 'unit', 'misfit_reduction_fitted',
                 'misfit_reduction_held_out', 'p_value')
PLOT_SUFFIXES = ('.png', '.svg', '.pdf')


@dataclass(frozen=True)
class Plot:
    """A figure: a notebook shows it, `save` writes it, `figure` is matplotlib's own object.

    chart: what it shows; spare: refuses a path that is an input of the result.
    """

    chart: Chart = field(repr=False)
    spare: Callable[[Path], None] = field(repr=False)

    @cached_property
    def figure(self) -> Figure:
        """The figure, for changes by hand."""
        from saddlering_ros.pages.charts import draw

        return draw(self.chart)

    def save(self, path: Path | str) -> None:
        """Write a PNG, SVG or PDF, as the name ends."""
        inputs.check_path('path', path)
        suffix = Path(path).suffix.lower()
        if suffix not in PLOT_SUFFIXES:
            raise ApiError(f'{path}: cannot be saved under this name: end the name with '
                           f'{", ".join(PLOT_SUFFIXES)}')
        self.spare(Path(path))
        with files.whole_file(path, ApiError) as temporary:
            self.figure.savefig(temporary, format=suffix.lstrip('.'))

    def _repr_png_(self) -> bytes:
        from saddlering_ros.pages.html import png

        return png(self.figure)


@dataclass(frozen=True, repr=False)
class Result(Tabular):
    """Methods that every result has. bags: its inputs; files: rig and parameter files."""

    bags: tuple[Bag, ...]
    rig: Rig
    files: tuple[Origin, ...]

    def __str__(self) -> str:
        return self.summary()

    @abstractmethod
    def plot(self) -> Plot:
        """The figure that shows the result best."""

    def write_report(self, path: Path | str, *, command: str = '') -> tuple[Path, ...]:
        """Write the report, one HTML file that opens offline, and the curves of runs as CSV.

        command: the command line that makes it. Returns the paths written.
        """
        from saddlering_ros.report.figures import curves_path

        inputs.check_path('path', path)
        self._spare_inputs(path, curves_path(path))
        return self._write_report(Path(path), command)

    @abstractmethod
    def _write_report(self, path: Path, command: str) -> tuple[Path, ...]:
        """The same after the checks."""

    @abstractmethod
    def _document(self) -> dict[str, Any]:
        """The JSON of the underlying result."""

    def to_json(self) -> dict[str, Any]:
        """Everything as plain dictionaries, lists and numbers, as `--json` writes it."""
        document = self._document()
        made = document['provenance']
        read = [*made['files'], *(origin.as_dict() for origin in self.files)]
        return {**document, 'provenance': {**made, 'files': read}}

    def save(self, path: Path | str) -> None:
        """Write the result; the suffix selects .json (all figures) or .csv (table of `columns`).

        .yaml writes the parameter file, where the result has parameters of its own.
        """
        inputs.check_path('path', path)
        where = Path(path)
        self._spare_inputs(where)
        if where.suffix == '.json':
            files.write_text(where, json.dumps(self.to_json(), indent=2) + '\n')
        elif where.suffix == '.csv':
            files.write_csv(where, self.columns(), ApiError)
        elif where.suffix in ('.yaml', '.yml') and isinstance(self, ParametricResult):
            self.save_parameters(where)
        else:
            more = ', .yaml' if isinstance(self, ParametricResult) else ''
            raise ApiError(f'{where}: cannot be saved under this name: end the name with '
                           f'.json, .csv{more}')

    def _spare_inputs(self, *outputs: Path | str) -> None:
        """FileConflict if an output would replace a bag or a file of this result."""
        for output in map(Path, outputs):
            files.spare_files(
                output, str(output), ((Path(one.path), one.path) for one in self.files))
            files.spare_bags(output, str(output), (
                (files.bag_folder(bag.path), str(bag.path)) for bag in self.bags
                if bag.run.sha256))

    def _repr_html_(self) -> str:
        from saddlering_ros.pages import html

        columns = self.columns()
        rows = [['' if value is None else html.number(f'{value:.5g}') if isinstance(value, float)
                 else str(value) for value in row] for row in zip(*columns.values(), strict=True)]
        return html.paragraph(self._headline()) + html.table(list(columns), rows)


class ParametricResult(Result):
    """A result with parameters of its own."""

    @property
    @abstractmethod
    def parameters(self) -> ParameterSet:
        """Contact law and effects, for `validate` and for nodes."""

    def save_parameters(self, path: Path | str) -> None:
        """Write the parameter file under any name."""
        inputs.check_path('path', path)
        self._spare_inputs(path)
        write_parameters(Path(path), self.parameters)


@dataclass(frozen=True, repr=False)
class IdentificationResult(ParametricResult):
    """Contact parameters with their uncertainty; `found` holds every figure."""

    found: Identification

    @property
    def parameters(self) -> ParameterSet:
        """The identified contact law."""
        return self.found.parameters

    @cached_property
    def validation(self) -> ValidationResult:
        """The validation of the parameters on the fitted bags."""
        from saddlering_ros.api.functions import validate

        return validate(self.bags, parameters=self.parameters, rig=self.rig)

    def summary(self) -> str:
        """Values with errors and intervals, correlations, notes."""
        return identification_text(self.found)

    def columns(self) -> dict[str, list[Any]]:
        """One row per parameter: value, std, 95 % interval or None, unit, note."""
        return _columns_of_law(self.found)

    def _tables(self) -> dict[str, Callable[[], Columns]]:
        beside = self.found.beside_errors
        return {} if beside is None else {'beside_errors': lambda: _columns_of_law(beside)}

    def plot(self) -> Plot:
        """Measured and simulated with these parameters, for the fitted bags."""
        return self.validation.plot()

    def _write_report(self, path: Path, command: str) -> tuple[Path, ...]:
        from saddlering_ros.report.reports import write_validation_report

        return write_validation_report(path, self.validation.found, runs_of(self.bags), self.rig,
                                       self.found.to_json(), command)

    def _document(self) -> dict[str, Any]:
        return self.found.to_json()

    def _headline(self) -> str:
        return (f'Identification ({self.found.method} method) from '
                f'{counted(len(self.bags), "bag")}: {self.found.status}')


@dataclass(frozen=True, repr=False)
class ValidationResult(Result):
    """Validation of parameters on bags; `found` holds every figure and the curves."""

    found: Validation

    def summary(self) -> str:
        """A table of every run and channel, and which criteria are met."""
        return validation_text(self.found)

    def columns(self) -> dict[str, list[Any]]:
        """One row per run and channel, with every number of `validate --json`."""
        return columns_of([
            {'bag': run.name, 'test': run.test, 'elevation_deg': float(np.degrees(run.elevation)),
             'channel': channel, **figures} for run in self.found.runs
            for channel, figures in zip(run.channels, _without(
                list(map(vars, run.channels.values())), 'iso18571_parts'), strict=True)])

    def _curves(self) -> list[RunCurves]:
        from saddlering_ros.report.reports import curves_of_validation

        return curves_of_validation(self.found, runs_of(self.bags), self.rig)

    def _tables(self) -> dict[str, Callable[[], Columns]]:
        from saddlering_ros.report.figures import curve_columns

        return {'curves': lambda: curve_columns(self._curves())}

    def plot(self) -> Plot:
        """Measured and simulated, one column per run: static runs over load, dynamic over time."""
        from saddlering_ros.report import figures

        curves = self._curves()
        static = [run for run in curves if run.test == 'static']
        return Plot(figures.comparison((static or curves)[:3]), self._spare_inputs)

    def _write_report(self, path: Path, command: str) -> tuple[Path, ...]:
        from saddlering_ros.report.reports import write_validation_report

        return write_validation_report(path, self.found, runs_of(self.bags), self.rig,
                                       command=command)

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """Each criterion: whether it is met, and its worst run and channel."""
        return judge(self.found.runs, self.found.parameters.source.undetermined)

    def save_plots(self, folder: Path | str) -> list[Path]:
        """One PNG per run in `folder`; the paths written."""
        from saddlering_ros.report.reports import plot_paths, save_plots

        inputs.check_path('folder', folder)
        self._spare_inputs(*plot_paths(self.found, Path(folder)))
        return save_plots(self.found, runs_of(self.bags), Path(folder), self.rig)

    def _document(self) -> dict[str, Any]:
        return {**self.found.to_json(), 'criteria': [asdict(one) for one in self.criteria]}

    def _headline(self) -> str:
        met = [one.is_met for one in self.criteria]
        return (f'Validation on {counted(len(self.bags), "bag")}: {sum(met)} of {len(met)} '
                'criteria are met')


@dataclass(frozen=True, repr=False)
class DiagnosisResult(ParametricResult):
    """The verdict on bags; `found` holds every figure."""

    found: Verdict

    @cached_property
    def document(self) -> VerdictDocument:
        """The verdict as typed plain data, the source of all output."""
        return self.found.to_json()

    @property
    def verdict(self) -> str:
        """'none', 'named', 'ambiguous' or 'unknown'."""
        return self.found.verdict

    @property
    def causes(self) -> tuple[str, ...]:
        """Ids of the causes, the strongest first."""
        return tuple(cause['effect'] for cause in causes_of(self.document))

    @property
    def next_test(self) -> str | None:
        """The measurement that separates the possible causes, or confirms the named cause."""
        return self.found.next_test

    @property
    def parameters(self) -> ParameterSet:
        """Contact law after the diagnosis, with the effects found."""
        return self.found.extended_parameters()

    def summary(self) -> str:
        """The verdict, its causes with their misfit reduction, and the next test."""
        return document_text(self.document)

    def columns(self) -> dict[str, list[Any]]:
        """One row per parameter of a cause: size, std, unit, misfit reduction, p-value."""
        return columns_of([
            {'cause': cause['effect'], 'title': cause['title'], 'parameter': name, **item,
             'misfit_reduction_fitted': cause['gain']['fit'],
             'misfit_reduction_held_out': cause['gain']['held_out'], **cause['evidence']}
            for cause in causes_of(self.document) for name, item in cause['parameters'].items()
        ], CAUSE_COLUMNS)

    def _tables(self) -> dict[str, Callable[[], Columns]]:
        from saddlering_ros.report.figures import curve_columns, curves_of

        said: Mapping[str, Any] = self.document
        return {
            'candidates': lambda: columns_of([
                {**item, 'effects': ' + '.join(item['effects'])}
                for item in _without(said.get('candidates') or (), 'parameters')]),
            'limits': lambda: columns_of(_without(said.get('detection_limits') or (), 'places')),
            'misfit': lambda: columns_of([
                {**{key: run[key] for key in ('bag', 'test', 'elevation_deg', 'held_out')},
                 'channel': name, **item}
                for run in said['runs'] for name, item in run['channels'].items()]),
            'probabilities': lambda: {
                'outcome': list(said.get('probabilities') or {}),
                'probability': list((said.get('probabilities') or {}).values())},
            'curves': lambda: curve_columns(curves_of(self.found))}

    def plot(self) -> Plot:
        """Misfit of every run and channel before and after, beside the noise."""
        from saddlering_ros.report import figures

        return Plot(figures.misfit(self.document), self._spare_inputs)

    def _write_report(self, path: Path, command: str) -> tuple[Path, ...]:
        from saddlering_ros.report.reports import write_diagnosis_report

        return write_diagnosis_report(self.found, path, command)

    def with_effect_files(self, folder: Path | str) -> DiagnosisResult:
        """The same verdict; the effects of a proposed law are written into `folder`.

        No file is written without a proposed law. `saddlering ... --effects FOLDER` uses them.
        """
        from saddlering_ros.diagnosis.proposed_law import effect_paths, write_effect_files

        inputs.check_path('folder', folder)
        law = self.found.diagnosis.law
        if law is None:
            return self
        self._spare_inputs(*effect_paths(law, Path(folder)))
        paths = write_effect_files(law, Path(folder), self.found.rig.full_scale_load)
        return replace(
            self, found=replace(self.found, effect_files=tuple(str(path) for path in paths)))

    def _document(self) -> dict[str, Any]:
        return dict(self.document)

    def _headline(self) -> str:
        from saddlering_ros.diagnosis.ring_wording import headline

        return f'{verdict_line(self.verdict).capitalize()}. {headline(self.document)}'


@dataclass(frozen=True, repr=False)
class ComparisonResult(Result):
    """What changed between two sessions; `change` holds every figure."""

    change: Change

    @property
    def verdict(self) -> str:
        """'none', 'named', 'ambiguous' or 'unknown', of the change."""
        return self.change.verdict

    @property
    def headline(self) -> str:
        """The verdict in one sentence."""
        return self.change.headline

    def summary(self) -> str:
        """Verdict, changes with their errors, contact law, figures of makers, notes."""
        from saddlering_ros.report.reports import change_text

        return change_text(self.change)

    def columns(self) -> dict[str, list[Any]]:
        """One row per parameter of each cause: the change, its std, unit and p-value."""
        return columns_of([
            {'effect': cause.effect, 'parameter': name, 'change': size.value, 'std': size.std,
             'unit': size.unit, 'p_value': cause.p_value}
            for cause in self.change.diagnosis.causes for name, size in cause.parameters.items()
        ], ('effect', 'parameter', 'change', 'std', 'unit', 'p_value'))

    def plot(self) -> Plot:
        """The change of the later runs over the load."""
        from saddlering_ros.report.reports import change_chart

        return Plot(change_chart(self.change), self._spare_inputs)

    def _write_report(self, path: Path, command: str) -> tuple[Path, ...]:
        from saddlering_ros.report.reports import write_change_page

        write_change_page(self.change, path, command)
        return (path,)

    def _document(self) -> dict[str, Any]:
        return self.change.to_json()


def _columns_of_law(law: FittedLaw) -> dict[str, list[Any]]:
    return columns_of([
        {'parameter': name, 'value': entry['value'], 'std': entry['std'],
         **dict(zip(('low', 'high'), entry['interval'] or (None, None), strict=True)),
         'unit': entry['unit'], 'note': entry['reason'] or ''}
        for name, entry in law.entries.items()])


def _without(entries: Sequence[Any], left_out: str) -> list[dict[str, Any]]:
    """Entries without a nested part that no table holds."""
    return [{key: value for key, value in entry.items() if key != left_out} for entry in entries]
