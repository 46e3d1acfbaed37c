"""``autonerf-lab episodes``: sample and evaluate navigation episodes in Habitat's format."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, subcommand

from autonerf_lab.cli.options import SceneName, Seed, option


@dataclass(frozen=True)
class EpisodesEvaluateCommand:
    """Run PointNav or ObjectNav episodes in their scene, and print success and SPL by Habitat's definitions."""

    episodes: Annotated[Positional[Path], option(help="Episodes of Habitat: .json or .json.gz.")]
    scene: SceneName
    policy: Annotated[str, option(help="Policy: fast-marching, random, or module:Class.")] = "fast-marching"
    count: Annotated[int | None, option(metavar="N", help="Number of episodes.", default="all of the scene")] = None
    max_steps: Annotated[int, option(metavar="N", help="Actions after which an episode fails.")] = 500
    seed: Seed = 0
    out: Annotated[Path | None, option(metavar="FILE", help="Output .json file of the scores.")] = None

    def run(self) -> None:
        """Run the episodes and print the scores."""
        from autonerf_lab import pipeline
        from autonerf_lab.data.episodes import read_episodes, scene_name
        from autonerf_lab.evaluators.episodes import evaluate_episodes

        episodes = read_episodes(self.episodes)
        scene = pipeline.find_scene(self.scene)
        mine = [episode for episode in episodes if episode.scene == scene_name(scene.name)] or episodes
        scores = evaluate_episodes(self.policy, mine[: self.count], scene, max_steps=self.max_steps, seed=self.seed)
        print(scores.table())
        if self.out is not None:
            scores.save(self.out)


@dataclass(frozen=True)
class EpisodesSampleCommand:
    """Sample episodes in a scene and write them in Habitat's format."""

    scene: SceneName
    out: Annotated[Path, option(help="Output file: .json or .json.gz.")]
    kind: Annotated[Literal["pointnav", "objectnav"], option(help="Task: pointnav or objectnav.")] = "pointnav"
    count: Annotated[int, option(metavar="N", help="Number of episodes.")] = 100
    seed: Seed = 0

    def run(self) -> None:
        """Sample and write the episodes."""
        from autonerf_lab import pipeline
        from autonerf_lab.data.episodes import write_episodes
        from autonerf_lab.evaluators.episodes import sample_episodes

        print(
            write_episodes(sample_episodes(pipeline.find_scene(self.scene), self.count, self.seed, self.kind), self.out)
        )


@dataclass(frozen=True)
class EpisodesCommand:
    """Sample and evaluate PointNav and ObjectNav episodes in Habitat's format."""

    command: (
        Annotated[EpisodesEvaluateCommand, subcommand("evaluate")]
        | Annotated[EpisodesSampleCommand, subcommand("sample")]
    )

    def run(self) -> None:
        """Run the subcommand."""
        self.command.run()
