"""``--profile`` of the commands that run a pipeline: settings by use, where no option beside it says otherwise."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from viewshed.cli import _options as options

if TYPE_CHECKING:
    from viewshed.cli._outputs import Named
    from viewshed.guarantees.envelope import Threat
    from viewshed.pipeline.reactions import ReactionRules

ProfileName = Annotated[
    str | None,
    typer.Option(
        "--profile",
        help="Settings for a use: robot, infrastructure, mapping or contested; other options win over them.",
    ),
]

CertifyOnAlarm = Annotated[
    str | None,
    typer.Option(
        "--certify",
        metavar="THREAT",
        help="On an alarm go on claiming what no such attack can have opened: added (any points), window:5 (beams at a"
        " target), … as in viewshed estimate; needs --sensor, --height and --attitude, unless the files say them.",
    ),
]

CertifiedOnly = Annotated[
    bool,
    typer.Option("--certified-only", help="Claim only what --certify certifies, be there an alarm or not."),
]

Method = Annotated[
    str | None, typer.Option(help="Method: shadow_map (if not given), majority_vote, first_blocker, unet, …")
]

Value = TypeVar("Value")


@dataclass(frozen=True, slots=True)
class PipelineOptions:
    """What the options say of the pipeline that ``replay`` and ``record`` run."""

    profile: ProfileName = None
    method: Method = None
    grid: options.GridName = "road"
    target: options.TargetName = "car"
    history: options.HistorySweeps = 0
    monitor: options.WithMonitor = False
    monitor_file: options.MonitorFile = None
    certify: CertifyOnAlarm = None
    certified_only: CertifiedOnly = False

    def settings(self, ctx: typer.Context) -> PipelineSettings:
        """Return what they come to with the profile."""
        return settings(
            ctx, self.profile, method=self.method, grid=self.grid, history=self.history, monitor=self.monitor,
            certify=self.certify, certified_only=self.certified_only,
        )  # fmt: skip


AS_USUAL = PipelineOptions()


@dataclass(frozen=True, slots=True)
class PipelineSettings:
    """What a pipeline is run with."""

    method: str | None  # name of the estimator; None for the usual one
    grid: str  # name of the grid
    history: int  # earlier sweeps that help
    monitor: bool  # whether the stream is watched
    rules: ReactionRules  # how caution rises and falls
    rate_hz: float  # sweeps of an agent that are estimated in a second of the recording; 0 for all
    certify: Threat | None  # the threat whose certificate an alarm falls back to; None for none
    certified_only: bool  # whether only certified cells are claimed

    def at_rate(self, sweeps: Iterable[Named]) -> Iterator[Named]:
        """Return the sweeps without those that come sooner after the one before of their agent than the rate allows."""
        from viewshed.pipeline import RateLimit

        limit = RateLimit(self.rate_hz)
        return (named for named in sweeps if limit.takes(named.sweep.agent, named.sweep.t_ns))


def settings(
    ctx: typer.Context,
    profile: str | None,
    *,
    method: str | None,
    grid: str,
    history: int,
    monitor: bool,
    certify: str | None,
    certified_only: bool = False,
) -> PipelineSettings:
    """Return the settings of a profile, of those options that are given, and the usual ones where there is neither."""
    from viewshed.guarantees.envelope import Threat
    from viewshed.pipeline.profiles import profile_named
    from viewshed.pipeline.reactions import RULES

    threat = None if certify is None else Threat.parse(certify)
    if profile is None:
        return PipelineSettings(method, grid, history, monitor, RULES, 0.0, threat, certified_only)
    found = profile_named(profile)

    def chosen(name: str, given: Value, otherwise: Value) -> Value:
        source = ctx.get_parameter_source(name)
        return otherwise if source is None or source.name == "DEFAULT" else given

    return PipelineSettings(
        chosen("method", method, found.method),
        chosen("grid", grid, found.grid),
        chosen("history", history, found.history),
        chosen("monitor", monitor, found.monitor),
        found.rules,
        found.rate_hz,
        threat or found.certify,
        certified_only,
    )
