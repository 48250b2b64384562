"""The two pages: what is told of the paper's protocol and of the strict one, with their figures."""

from __future__ import annotations

from collections.abc import Iterator

from viewshed.attacks import ATTACKS
from viewshed.report import facts
from viewshed.reproduce import figures, other_tables, strict_tables, tables
from viewshed.reproduce.jobs import STEPS, keys_of
from viewshed.reproduce.published import BENIGN, OTHERS, SUB_TABLES
from viewshed.reproduce.results import Results
from viewshed.vulnerability.page import Block, Heading, Picture, Text, to_markdown

TITLES = {"paper": "The published study, made again", "strict": "The published study, held against exact truth"}
_PAPER = """\
arXiv 2503.07375 made again on simulated sweeps: its network, label, grid, threshold and attacks. The truth is the
paper's label, the farthest return in polar bins of the *clean* sweep, which is itself one of the contestants: agreeing
with it is not being right. What is right is on [the strict page](reproduce_strict.md). Rows are test sets, columns
training sets; a cell is precision, recall, accuracy (in hundredths) and F1, pooled over all cells of the held-out
sweeps. Sweeps tested on are of scenes and of a seed that nothing was trained or chosen on. Intervals are 95 %, by a
bootstrap over the scenes (1,000 draws): how far a figure depends on which scenes were drawn."""
_STRICT = """\
The same networks trained on exact truth (`probe`, car, where it is known) and held against it, on the presets' own
grids and with a threshold of .5, beside every classical estimator, **whoever wins**. Networks see counts of returns,
nothing else. What is bold is the best of its row, or of its column where columns are figures. Intervals and scenes as
on [the paper's page](reproduce_paper.md)."""
_MIXTURE = """\
All held-out sweeps of the 72 pairs, networks on the domain that they were trained in, in the same table as the
classical estimators."""
_CALIBRATION = """\
Of the same sweeps. ECE: mean distance of probability and frequency over 15 bins. Brier: mean squared error. AURC: mean
share of wrong cells over all coverages, the least doubtful cells first (doubt is the distance of the probability from
.5, or the deviation). An estimator that gives a mask is calibrated where it makes no error."""
_TRADE = """\
Networks of the paper's protocol, trained without attacks and tested on benign sweeps, with fewer epochs than the
models above: compare them with each other. Latency is the median of single passes in ONNX Runtime, the input made
already. FLOPs are multiplications and additions of the convolutions."""
_MONITOR = """\
The paper's detector: a cell is suspect if its deviation over the passes is above the threshold that it has from benign
sweeps, and the sweep's score is the share of suspect cells. Fitted, calibrated and reported on different held-out
scenes. AUROC: how often an attacked sweep scores above a benign one (.5 is chance). *Caught at 1 %*: share of the
sweeps above a limit that at most 1 % of these benign sweeps pass. *Alarms*: at the calibrated limit. *AUROC of the
mean*: of the plain mean deviation. Paper: no figures."""


def files_of(results: Results, protocol: str) -> dict[str, bytes]:
    """Return the files of a protocol's page by name: figures first, the page last.

    Raises:
        ValueError: there are no results of the protocol.
    """
    if not any(key.protocol == protocol for key in results.pairs):
        raise ValueError(f"{results.store.path} must hold pairs of the {protocol} protocol, got none; run step pairs")
    blocks = [block for block in _blocks(results, protocol) if block is not None]
    files = {block.name: block.png for block in blocks if isinstance(block, Picture)}
    page = to_markdown(TITLES[protocol], facts(**told(results, protocol)), blocks)
    return files | {f"reproduce_{protocol}.md": page.encode()}


def told(results: Results, protocol: str) -> dict[str, str]:
    """Return what a page rests on, by name."""
    plan = results.store.plan
    sweeps = ", ".join(
        f"{domain} {len(scenes)} of {len(set(scenes))} scenes"
        for (of, domain), scenes in sorted(results.scenes.items())
        if of == protocol
    )
    shape = f"{plan.cells} × {plan.cells} cells, width {plan.width}, depth {plan.depth}, dropout {plan.dropout:g}"
    seen = ", ".join(plan.trained_attacks)
    attacks = {
        "paper": "the paper's mixture, in training and test",
        "strict": f"trained on {seen} ({100 * plan.attack_share:.0f} % of the sweeps); the others are never seen",
    }
    return {
        "plan": f"{plan.name}: {plan.about}", "seeds": f"{plan.seed} trained, {plan.test_seed} tested",
        "network": f"{shape}; {plan.passes} passes for MCD",
        "training": f"at most {plan.epochs} epochs of {plan.frames_per_epoch} sweeps, batches of {plan.batch}, "
        f"{plan.loss}, Adam {plan.learning_rate:g} ({plan.schedule}), stopped after {plan.patience} without gain",
        "held-out sweeps": sweeps, "attacks": attacks[protocol],
        "commits of the run": ", ".join(sorted(commit[:7] for commit in results.commits)) or "unknown",
    }  # fmt: skip


def _blocks(results: Results, protocol: str) -> Iterator[Block | None]:
    yield Text(_PAPER if protocol == "paper" else _STRICT)
    yield _unfinished(results, protocol)
    yield from _paper_blocks(results) if protocol == "paper" else _strict_blocks(results)
    yield Heading(2, "Trainings")
    yield other_tables.training_table(results, protocol)


def _unfinished(results: Results, protocol: str) -> Text | None:
    """Say which steps are not finished."""
    done, words = results.store.keys(), []
    for step in STEPS:
        keys = keys_of(results.store.plan, step, [protocol])
        there = sum(key in done for key in keys)
        if there < len(keys):
            words.append(f"{step} {there} of {len(keys)}")
    return Text(f"**Not finished:** {', '.join(words)}.") if words else None


def _paper_blocks(results: Results) -> Iterator[Block | None]:
    yield Heading(2, "Targets")
    yield tables.target_table(results)
    for table in SUB_TABLES:
        yield Heading(2, table.title)
        yield tables.pair_table(results, "paper", table)
        yield tables.area_table(results, "paper", table)
    yield Heading(2, "Beside the classical estimators")
    yield Text(_MIXTURE)
    yield figures.violin_picture(results, "paper")
    yield from _by_domain(results, "paper")
    yield Heading(2, "Mean and deviation")
    yield figures.mcd_picture(results, "paper")
    if "trade" in results.others:
        yield Heading(2, "Width, depth, resolution")
        yield Text(_TRADE)
        yield figures.trade_picture(results)
        yield other_tables.trade_table(results)
    yield Heading(2, "The rest of the 72 pairs")
    for table in OTHERS:
        yield Heading(3, table.title)
        yield tables.pair_table(results, "paper", table)


def _by_domain(results: Results, protocol: str) -> Iterator[Block]:
    for domain in tables.domains_of(results.store.plan):
        yield Heading(3, domain)
        yield tables.mixture_table(results, protocol, domain)
    yield Heading(2, "Calibration")
    yield Text(_CALIBRATION)
    for domain in tables.domains_of(results.store.plan):
        yield Heading(3, f"Calibration, {domain}")
        yield tables.calibration_table(results, protocol, domain)


def _strict_blocks(results: Results) -> Iterator[Block | None]:
    if results.strict:
        yield from _attack_blocks(results)
    yield Heading(2, "72 pairs")
    yield Text("Attacked sweeps face one attack each, all that touch returns in turn, with their default budgets.")
    for table in (*SUB_TABLES, *OTHERS):
        yield Heading(3, table.title if table is BENIGN else table.title.replace("Left out by the paper: t", "T"))
        yield tables.pair_table(results, "strict", table)
    yield Heading(2, "All attacks together, beside the classical estimators")
    yield Text(_MIXTURE)
    yield figures.violin_picture(results, "strict")
    yield from _by_domain(results, "strict")
    yield Heading(2, "Mean and deviation")
    yield figures.mcd_picture(results, "strict")
    if "monitor" in results.others:
        plan = results.store.plan
        yield Heading(2, "The anomaly detector")
        rate = f"{plan.monitor_false_alarms:g}"
        yield Text(f"{_MONITOR} Domain {plan.monitor_domain}, calibrated for a rate of {rate} false alarms.")
        yield other_tables.monitor_table(results, "attack")
        yield Text(f"Benign corruptions of severity {plan.monitor_severity}: an alarm here is a false one.")
        yield other_tables.monitor_table(results, "corruption")


def _attack_blocks(results: Results) -> Iterator[Block]:
    plan = results.store.plan
    yield Heading(2, "Every attack, every contestant")
    yield Text(
        f"{plan.strict_frames} sweeps a domain under all {len(ATTACKS)} attacks with their default "
        "budgets. A star: the adversarially trained networks have seen it. *In the wedge*: only cells in the azimuths "
        "that the attacker reaches, precision / recall / F1, above the same with no return touched. Attackers do not "
        "know the estimator."
    )
    for domain in tables.domains_of(plan):
        yield Heading(3, f"Who wins, {domain}")
        yield strict_tables.seen_table(results, domain)
        yield strict_tables.winner_table(results, domain)
        yield Heading(3, f"F1 in the view, {domain}")
        yield strict_tables.view_table(results, domain)
        yield Heading(3, f"In the wedge, {domain}")
        yield strict_tables.wedge_table(results, domain)
        yield from figures.severity_pictures(results, domain)
    if results.refused:
        refused = sorted(results.refused.items())
        words = (f"{case.name} in {domain} ({count} times: {why})" for (domain, case, why), count in refused)
        yield Text(f"Could not be made: {'; '.join(words)}.")
