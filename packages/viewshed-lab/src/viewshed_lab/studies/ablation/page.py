"""The page of the ablation: its tables; what it says stands in ``page.md``."""

from __future__ import annotations

from viewshed.preprocess.history import HISTORY_SWEEPS
from viewshed_lab._page import facts
from viewshed_lab.studies.ablation import tables
from viewshed_lab.studies.ablation.evaluate import MARGIN, POINTS, SECTOR_DEG
from viewshed_lab.studies.ablation.plan import AblationPlan
from viewshed_lab.studies.ablation.results import SettingResults, targets_elsewhere, targets_of
from viewshed_lab.studies.pages import fill_template
from viewshed_lab.studies.samples import CLEAR
from viewshed_lab.studies.store import ResultStore


def files_of(store: ResultStore[AblationPlan]) -> dict[str, bytes]:
    """Return the page as a file by its name; parts without results are left out."""
    plan = store.plan
    validation = SettingResults.read(store, "validation", plan.config)
    tests = {setting: SettingResults.read(store, "test", setting) for setting in plan.settings}
    test, chosen = tests[plan.config], SettingResults.read(store, "chosen", plan.config)
    targets = {plan.title_of(plan.config): targets_of(validation, test, chosen)}
    targets |= {plan.title_of(setting): targets_elsewhere(tests[setting]) for setting in plan.others}

    page = fill_template(
        "ablation/page.md", plan=plan, targets=targets, validation=validation, chosen=chosen, main=test, tables=tables,
        reported=[one for one in tests.values() if one.methods], clear=CLEAR, margin=MARGIN, points=POINTS,
        sector_deg=SECTOR_DEG, history_sweeps=HISTORY_SWEEPS,
    )  # fmt: skip
    about = facts(
        plan=plan.name, config=plan.config, domain=plan.domain, sweeps=str(plan.sweeps), seed=str(plan.seed),
        test_sweeps=str(plan.test_sweeps), test_seed=str(plan.test_seed),
        others=", ".join(f"{preset} ({config})" for config, preset in plan.others.items()) or "none",
        other_sweeps=str(plan.other_sweeps), chosen_sweeps=str(plan.chosen_sweeps),
    )  # fmt: skip
    return page.files("ablation.md", about)
