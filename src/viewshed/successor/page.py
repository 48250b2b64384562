"""The page of the ablation: what each part is worth, and the shipped network on the reported scenes."""

from __future__ import annotations

from math import isnan

from viewshed.metrics import Scores
from viewshed.report import facts
from viewshed.reproduce.store import JobStore
from viewshed.successor.contest import BENIGN, CASES
from viewshed.successor.plan import WHOLE, AblationPlan
from viewshed.successor.results import Results
from viewshed.successor.targets import OURS, Target, targets_of
from viewshed.vulnerability.page import Block, Heading, Table, Text, to_markdown
from viewshed.vulnerability.tables import three

_ABLATION = """\
Each network is trained by the same config but for what its line says, and tried on the same sweeps of other scenes,
which no network was fitted to; the classical estimators stand below. F1 is of all cells whose truth is known, at a
probability of .5. *Trained* and *unseen*: mean over the attacks that `whole` is trained on and over those that it never
met, each with its default budget; jamming apart, which is in neither. *Wedge*: precision / recall in the azimuths that
the attacker reaches, of attacks that open a view (those of the two groups). *No rings*: clouds without rings and
sensor. ECE has 15 bins. One training each: differences of some thousandths are within the spread of trainings."""
_TEST = """\
Other scenes again. They were looked at once, with the networks that the package ships. *F1* of the view:"""
_WEDGE = "Precision / recall in the wedge of attacks that have one:"
_ABSTENTION = """\
Cells in doubt become UNKNOWN: claimed is only what has at least the probability from which claims in attacked wedges
were right often enough on the scenes of the ablation, over the attacks trained on. Precision / recall in the wedges of
attacks that open a view, here:"""


_TARGETS = """\
What was aimed at, beside the figure of the shipped `viewnet` on the reported scenes, one sweep at a time. An attack
counts with its default budget. Probabilities from which claims are sure are taken from the scenes of the ablation."""
_DOUBT = """\
How good probabilities and doubts are, on all cells whose truth is known: expected calibration error, Brier score, and
area under the risk-coverage curve (smaller is better) with cells ordered by |p - .5| and by the deviation. `viewnet`
tells its deviation in the same pass as its probability."""


def page_of(store: JobStore[AblationPlan]) -> str:
    """Return the page as Markdown; parts without results are left out."""
    plan, blocks = store.plan, list[Block]()
    validation, test = (Results.read(store, split) for split in ("validation", "test"))
    targets = targets_of(validation, test)
    if targets:
        blocks += [Heading(2, "Targets"), Text(_TARGETS), _targets(targets)]
    if validation.said:
        blocks += [
            Heading(2, "What each part is worth"),
            Text(_ABLATION),
            _ablation(validation),
            _changes(plan),
        ]
    if test.said:
        blocks += [Heading(2, "The shipped networks"), Text(_TEST), _views(test), Text(_WEDGE), _wedges(test)]
        blocks += [Heading(3, "Doubt"), Text(_DOUBT), _doubts(test)]
    if test.said and validation.said:
        blocks += [Text(_ABSTENTION), _abstention(validation, test)]
    told = facts(
        plan=plan.name, config=plan.config, domain=plan.domain, sweeps=str(plan.sweeps), seed=str(plan.seed),
        test_sweeps=str(plan.test_sweeps), test_seed=str(plan.test_seed),
    )  # fmt: skip
    return to_markdown("The network and what its parts are worth", told, blocks)


def _targets(targets: list[Target]) -> Table:
    rows = [[each.what, each.wanted, each.found, "met" if each.met else "**missed**"] for each in targets]
    return Table(["what", "target", "here", ""], rows)


def _ablation(results: Results) -> Table:
    columns = list(results.figures(WHOLE))
    names = list(results.said)
    rows = []
    for name in names:
        size = results.plan.config_of(name).shape if name in results.plan.variants else None
        cost = "–" if size is None else f"{size.flops(results.plan.config_of(name).cells) / 1e9:.2f}"
        rows.append([name, cost, *(three(value) for value in results.figures(name).values())])
    return Table(["network", "GFLOP", *columns], rows)


def _changes(plan: AblationPlan) -> Table:
    rows = [[name, ", ".join(f"{key} = {value}" for key, value in changes.items()) or "–"]
            for name, changes in plan.variants.items()]  # fmt: skip
    return Table(["network", "what its line changes"], rows)


def _views(results: Results) -> Table:
    names = list(results.said)
    rows = []
    for case in CASES:
        scores = [results.f1(name, [case]) for name in names]
        most = max((score for score in scores if not isnan(score)), default=float("nan"))
        rows.append([_kind(results, case), *(f"**{three(s)}**" if s == most else three(s) for s in scores)])
    return Table(["case", *names], rows)


def _wedges(results: Results) -> Table:
    names = list(results.said)
    rows = []
    for case in CASES:
        wedges = [results.wedge(name, [case]) for name in names]
        if wedges[0].cells:
            rows.append([_kind(results, case), *map(_both, wedges)])
    return Table(["case", *names], rows)


def _abstention(validation: Results, test: Results) -> Table:
    step = validation.sure
    ours = [OURS] if OURS in test.said else []
    rows = [[name, f"{step:g}", *(_both(test.wedge(name, cases), step) for cases in test.opening)] for name in ours]
    return Table(["network", "claimed from", "attacks trained on", "unseen attacks"], rows)


def _doubts(results: Results) -> Table:
    groups = {"benign": (BENIGN,), "trained": results.trained, "unseen": results.unseen}
    rows = []
    for name in results.said:
        cells = []
        for cases in groups.values():
            scores = sum(results.view(name, cases), Scores())
            cells += [_four(value) for value in (scores.ece(), scores.brier(), scores.aurc(), scores.aurc_std())]
        rows.append([name, *cells])
    heads = [f"{what}, {group}" for group in groups for what in ("ECE", "Brier", "AURC", "AURC by deviation")]
    return Table(["", *heads], rows)


def _kind(results: Results, case: str) -> str:
    return f"{case} \\*" if case in results.plan.config_of(WHOLE).attacks else case


def _both(scores: Scores, threshold: float = 0.5) -> str:
    return f"{three(scores.precision(threshold))} / {three(scores.recall(threshold))}"


def _four(value: float) -> str:
    return "–" if isnan(value) else f"{value:.4f}"
