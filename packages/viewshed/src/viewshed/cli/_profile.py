"""``--profile`` of the commands that run a pipeline: default settings by use case, which other options override."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from viewshed.cli import _options as options

if TYPE_CHECKING:
    from viewshed.cli._outputs import Named
    from viewshed.pipeline.profiles import Profile

ProfileName = Annotated[
    str | None,
    typer.Option(
        "--profile",
        help="Settings for a use case: robot, infrastructure, mapping or contested; other options override them.",
    ),
]

CertifyOnAlarm = Annotated[
    str | None,
    typer.Option(
        "--certify",
        metavar="THREAT",
        help="During an alarm, claim only cells that no such attack can have made visible: added (any points),"
        " window:5 (beams at a target), … as in viewshed estimate; needs --sensor, --height and --attitude, unless"
        " the files state them.",
    ),
]

CertifiedOnly = Annotated[
    bool,
    typer.Option("--certified-only", help="Claim only what --certify certifies, even without an alarm."),
]

Method = Annotated[
    str | None, typer.Option(help="Method: shadow_map (the default), majority_vote, first_blocker, unet, …")
]


@dataclass(frozen=True, slots=True)
class PipelineOptions:
    """Options of the pipeline that ``replay`` and ``record`` run."""

    profile: ProfileName = None
    method: Method = None
    grid: options.GridName = "road"
    target: options.TargetName = "car"
    history: options.HistorySweeps = 0
    monitor: options.WithMonitor = False
    monitor_file: options.MonitorFile = None
    certify: CertifyOnAlarm = None
    certified_only: CertifiedOnly = False

    def settings(self, ctx: typer.Context) -> Profile:
        """Return the resulting settings: given options, else those of the profile, else the defaults."""
        from viewshed.guarantees.envelope import Threat
        from viewshed.pipeline.profiles import Profile, profile_named
        from viewshed.pipeline.reactions import RULES

        threat = None if self.certify is None else Threat.parse(self.certify)
        if self.profile is None:
            return Profile(self.method, self.grid, self.history, self.monitor, RULES, 0.0, threat)
        profile, given = profile_named(self.profile), dict[str, Any]()
        for name in ("method", "grid", "history", "monitor"):
            source = ctx.get_parameter_source(name)
            if source is not None and source.name != "DEFAULT":
                given[name] = getattr(self, name)
        return replace(profile, **given, certify=threat or profile.certify)


DEFAULT_PIPELINE = PipelineOptions()


def at_rate(sweeps: Iterable[Named], rate_hz: float) -> Iterator[Named]:
    """Return the sweeps, dropping those that exceed the rate of their agent."""
    from viewshed.pipeline import RateLimit

    limit = RateLimit(rate_hz)
    return (named for named in sweeps if limit.takes(named.sweep.agent, named.sweep.t_ns))
