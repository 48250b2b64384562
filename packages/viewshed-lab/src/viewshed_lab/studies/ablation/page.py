"""The page of the ablation: its tables; what it says stands in ``page.md``."""

from __future__ import annotations

from collections.abc import Callable

from viewshed.preprocess.history import HISTORY_SWEEPS
from viewshed_lab._page import Table, facts, to_markdown
from viewshed_lab.studies.ablation import tables
from viewshed_lab.studies.ablation.evaluate import MARGIN, POINTS, SECTOR_DEG
from viewshed_lab.studies.ablation.plan import AblationPlan
from viewshed_lab.studies.ablation.results import OURS, SHADOW_MAP, SettingResults, targets_elsewhere, targets_of
from viewshed_lab.studies.samples import CLEAR
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.studies.templates import fill_template


def page_of(store: ResultStore[AblationPlan]) -> str:
    """Return the page as Markdown; parts without results are left out."""
    plan = store.plan
    validation = SettingResults.read(store, "validation", plan.config)
    tests = {setting: SettingResults.read(store, "test", setting) for setting in plan.settings}
    test, chosen = tests[plan.config], SettingResults.read(store, "chosen", plan.config)
    targets = {plan.title_of(plan.config): targets_of(validation, test, chosen)}
    targets |= {plan.title_of(setting): targets_elsewhere(tests[setting]) for setting in plan.others}

    def ours(table: Callable[[SettingResults], Table]) -> Callable[[SettingResults], Table | None]:
        """Return what shows a table only of settings in which our network was tried."""
        return lambda test: table(test) if OURS in test.methods else None

    def history(table: Callable[[SettingResults, list[str]], Table]) -> Callable[[SettingResults], Table | None]:
        """Return what shows a table of those whom earlier sweeps help."""

        def fill(test: SettingResults) -> Table | None:
            names = [one for name in (OURS, SHADOW_MAP) if name in test.methods for one in test.with_history(name)]
            return table(test, names) if names else None

        return fill

    def abstention(of: SettingResults) -> Table | None:
        tried = of is test and OURS in test.methods and validation.methods
        return tables.abstention_table(validation, test) if tried else None

    values = {
        "settings": list(targets), "reported": [one for one in tests.values() if one.methods], "clear": CLEAR,
        "margin": MARGIN, "points": POINTS, "sector_deg": SECTOR_DEG, "history_sweeps": HISTORY_SWEEPS,
    }  # fmt: skip
    title, blocks = fill_template("ablation/page.md", values, {
        "targets_table": lambda setting: tables.targets_table(targets[setting]) if targets[setting] else None,
        "ablation_table": lambda: tables.ablation_table(validation) if validation.methods else None,
        "changes_table": lambda: tables.changes_table(plan) if validation.methods else None,
        "views_table": lambda test: tables.views_table(test, test.alone),
        "wedges_table": lambda test: tables.wedges_table(test, test.alone),
        "parts_table": tables.parts_table,
        "history_views_table": history(tables.views_table),
        "history_wedges_table": history(tables.wedges_table),
        "doubts_table": tables.doubts_table,
        "sure_table": ours(lambda test: tables.sure_table(test, wedge=False)),
        "sure_wedges_table": ours(lambda test: tables.sure_table(test, wedge=True)),
        "abstention_table": abstention,
        "chosen_table": lambda of: tables.chosen_table(chosen) if of is test and chosen.methods else None,
    })  # fmt: skip
    about = facts(
        plan=plan.name, config=plan.config, domain=plan.domain, sweeps=str(plan.sweeps), seed=str(plan.seed),
        test_sweeps=str(plan.test_sweeps), test_seed=str(plan.test_seed),
        others=", ".join(f"{preset} ({config})" for config, preset in plan.others.items()) or "none",
        other_sweeps=str(plan.other_sweeps), chosen_sweeps=str(plan.chosen_sweeps),
    )  # fmt: skip
    return to_markdown(title, about, blocks)
