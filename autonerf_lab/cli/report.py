"""``autonerf-lab report``."""

from dataclasses import dataclass

from autonerf_lab.cli.options import RunPath


@dataclass(frozen=True)
class ReportCommand:
    """Write the report of a run to RUN/report.html. An existing report is replaced."""

    folder: RunPath

    def run(self) -> None:
        """Run the stage."""
        from autonerf_lab import pipeline

        pipeline.run_stage(self.folder, "report")
        print(f"report: {self.folder / 'report.html'}")
