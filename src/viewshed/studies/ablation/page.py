"""The page of the ablation: what each part is worth, and the shipped network on the reported scenes."""

from __future__ import annotations

from collections.abc import Mapping

from viewshed._page import Heading, PageBlock, Text, facts, to_markdown
from viewshed.preprocess.history import HISTORY_SWEEPS
from viewshed.studies.ablation.evaluate import CLEAR, MARGIN, POINTS, SECTOR_DEG
from viewshed.studies.ablation.plan import AblationPlan
from viewshed.studies.ablation.results import OURS, SHADOW_MAP, SettingResults, Target, targets_elsewhere, targets_of
from viewshed.studies.ablation.tables import (
    ablation_table,
    abstention_table,
    changes_table,
    chosen_table,
    doubts_table,
    parts_table,
    sure_table,
    targets_table,
    views_table,
    wedges_table,
)
from viewshed.studies.store import ResultStore

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

_PARTS = f"""\
F1 of parts of the untouched view: cells {CLEAR}, whose true number of returns is more than {MARGIN}
from that from which on the target is visible; bands of range; and the sweeps of one sensor."""

_CHOSEN = f"""\
An attacker who has the victim itself (weights, channels, everything but the truth) adds {POINTS} points anywhere in a
wedge of {SECTOR_DEG:g}° aimed at a near obstacle, and wants cells claimed there that the victim did not claim before.
The channels count returns, so there is no gradient: plans are searched by an evolution strategy that asks the victim.
What it finds is a lower bound of what can be found. Each victim meets the points chosen against it, in the same wedge
of the first of the reported scenes. Precision / recall at a probability of .5:"""

_SURE = """\
With `--sure` cells in doubt are UNKNOWN: a cell with probability p is claimed from p = *sure* on and denied below
1 - *sure*, and nothing is told of the others. Share of the cells of which `viewnet` tells anything / precision of its
claims / precision of its denials, of the view:"""

_SURE_WEDGE = "The same in the wedges of attacks that have one; those that open a view once more on their own:"

_ABSTENTION = """\
Cells in doubt become UNKNOWN: claimed is only what has at least the probability from which claims in attacked wedges
were right often enough on the scenes of the ablation, over the attacks trained on. Precision / recall in the wedges of
attacks that open a view, here:"""


_PAST = f"""\
Those of the sweeps that have {HISTORY_SWEEPS} earlier ones of the sensor, a second apart. *Alone*: without them.
*Past*:
no one touched them; the attack has just begun. *Attacked past*: it has lasted, at the same place in the map.
*Wary*: claimed is only what one of the earlier sweeps would have seen as well (`--wary`). F1 of the view:"""

_TARGETS = """\
What was aimed at, beside the figure of the shipped `viewnet` on the reported scenes, one sweep at a time. An attack
counts with its default budget. Probabilities from which claims are sure are taken from the scenes of the ablation."""

_DOUBT = """\
How good probabilities and doubts are, on all cells whose truth is known: expected calibration error, Brier score, and
area under the risk-coverage curve (smaller is better) with cells ordered by |p - .5| and by the deviation. `viewnet`
tells its deviation in the same pass as its probability."""


def page_of(store: ResultStore[AblationPlan]) -> str:
    """Return the page as Markdown; parts without results are left out."""
    plan, blocks = store.plan, list[PageBlock]()
    validation = SettingResults.read(store, "validation", plan.config)
    tests = {setting: SettingResults.read(store, "test", setting) for setting in plan.settings}
    test, chosen = tests[plan.config], SettingResults.read(store, "chosen", plan.config)
    elsewhere = {plan.title_of(setting): targets_elsewhere(tests[setting]) for setting in plan.others}
    blocks += _aimed({plan.title_of(plan.config): targets_of(validation, test, chosen)} | elsewhere)
    if validation.methods:
        blocks += [
            Heading(2, "What each part is worth"),
            Text(_ABLATION),
            ablation_table(validation),
            changes_table(plan),
        ]
    blocks += _shipped(test)
    if OURS in test.methods and validation.methods:
        blocks += [Text(_ABSTENTION), abstention_table(validation, test)]
    if chosen.methods:
        blocks += [Heading(2, "Points chosen against their victim"), Text(_CHOSEN), chosen_table(chosen)]
    for setting in plan.others:
        blocks += _shipped(tests[setting])
    return to_markdown("The network and what its parts are worth", _facts(plan), blocks)


def _aimed(targets: Mapping[str, list[Target]]) -> list[PageBlock]:
    """Return what was aimed at in each setting, and what was found there."""
    tables: list[PageBlock] = []
    for title, aimed in targets.items():
        tables += [Heading(3, f"Targets, {title}"), targets_table(aimed)] if aimed else []
    return [Heading(2, "Targets"), Text(_TARGETS), *tables] if tables else []


def _shipped(test: SettingResults) -> list[PageBlock]:
    """Return what is said of the shipped networks in one setting."""
    if not test.methods:
        return []
    config, preset = test.plan.config_in(test.setting), test.plan.preset_in(test.setting)
    title = test.plan.title_of(test.setting)
    cells = f"{config.cells} cells a side of {config.grid.cell_m:g} m"
    about = f"Preset `{preset}`: {cells}; the target is a {config.target}."
    return [
        Heading(2, f"The shipped networks, {title}"), Text(about), Text(_TEST), views_table(test, test.alone),
        Text(_WEDGE), wedges_table(test, test.alone), Text(_PARTS), parts_table(test), *_earlier_sweeps(test),
        Heading(3, f"Doubt, {title}"), Text(_DOUBT), doubts_table(test),
        *(_where_sure(test) if OURS in test.methods else []),
    ]  # fmt: skip


def _earlier_sweeps(test: SettingResults) -> list[PageBlock]:
    """Return what earlier sweeps are worth to those whom they help; nothing where nobody was told of them."""
    names = [one for name in (OURS, SHADOW_MAP) if name in test.methods for one in test.with_history(name)]
    if not names:
        return []
    heading = Heading(3, f"Earlier sweeps, {test.plan.title_of(test.setting)}")
    return [heading, Text(_PAST), views_table(test, names), Text(_WEDGE), wedges_table(test, names)]


def _where_sure(test: SettingResults) -> list[PageBlock]:
    return [Text(_SURE), sure_table(test, wedge=False), Text(_SURE_WEDGE), sure_table(test, wedge=True)]


def _facts(plan: AblationPlan) -> dict[str, str]:
    return facts(
        plan=plan.name, config=plan.config, domain=plan.domain, sweeps=str(plan.sweeps), seed=str(plan.seed),
        test_sweeps=str(plan.test_sweeps), test_seed=str(plan.test_seed),
        others=", ".join(f"{preset} ({config})" for config, preset in plan.others.items()) or "none",
        other_sweeps=str(plan.other_sweeps), chosen_sweeps=str(plan.chosen_sweeps),
    )  # fmt: skip
