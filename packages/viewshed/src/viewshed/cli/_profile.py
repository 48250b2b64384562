"""``--profile`` of the commands that run a pipeline: settings by use, where no option beside it says otherwise."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

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
        """Return what they come to: of a profile where an option is not given, and the usual ones without one."""
        from viewshed.guarantees.envelope import Threat
        from viewshed.pipeline.profiles import profile_named
        from viewshed.pipeline.reactions import RULES

        threat = None if self.certify is None else Threat.parse(self.certify)
        names = ("method", "grid", "history", "monitor")
        chosen: dict[str, Any] = {name: getattr(self, name) for name in names}
        if self.profile is None:
            return PipelineSettings(**chosen, rules=RULES, certify=threat, certified_only=self.certified_only)
        found = profile_named(self.profile)
        for name in names:
            source = ctx.get_parameter_source(name)
            if source is None or source.name == "DEFAULT":
                chosen[name] = getattr(found, name)
        return PipelineSettings(
            **chosen, rules=found.rules, rate_hz=found.rate_hz, certify=threat or found.certify,
            certified_only=self.certified_only,
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
    rate_hz: float = 0.0  # sweeps of an agent that are estimated in a second of the recording; 0 for all
    certify: Threat | None = None  # the threat whose certificate an alarm falls back to; None for none
    certified_only: bool = False  # whether only certified cells are claimed

    def at_rate(self, sweeps: Iterable[Named]) -> Iterator[Named]:
        """Return the sweeps without those that come sooner after the one before of their agent than the rate allows."""
        from viewshed.pipeline import RateLimit

        limit = RateLimit(self.rate_hz)
        return (named for named in sweeps if limit.takes(named.sweep.agent, named.sweep.t_ns))
