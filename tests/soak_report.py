"""What a long run is judged by, and the page that tells of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from schemas.runtime.process import revision
from tests.running import ROOT

REPORT = ROOT / "reports/soak.md"
JUDGED_MIN = 10.0
RSS_MB_PER_MIN, DESCRIPTORS_MORE, PAGE_MB_PER_MIN = 1.0, 5, 0.5
"""What a process, and the page, may grow by."""


def wrong(row: dict[str, Any]) -> list[str]:
    """What a part did not keep to."""
    if "broken_off" in row:
        return [f"broken off: {row['broken_off']}"]
    said, did = row["summary"], row["did"]
    found = [f"left behind: {count} {what}" for what, count in row["left"].items() if count]
    if said.get("collisions"):
        found.append(f"{said['collisions']} collisions")
    if "killed" in did and row["part"] == "memory" and did["bank_sound"] != did["killed"]:
        found.append(f"the bank was damaged {did['killed'] - did['bank_sound']} times")
    if row["part"] in ("quiet", "fuzz") and said["restarts"]:
        found.append(f"restarts: {said['restarts_of']}")
    if row["part"] == "kills" and said["restarts"] != sum(did["killed"].values()):
        found.append(f"{said['restarts']} restarts for {sum(did['killed'].values())} kills")
    if row["minutes"] < JUDGED_MIN:
        return found
    for name, told in row["processes"].items():
        if told["mb_per_min"] > RSS_MB_PER_MIN:
            found.append(f"{name} grows by {told['mb_per_min']} MB/min")
        if abs(told["descriptors_more"]) > DESCRIPTORS_MORE:
            found.append(f"{name} has {told['descriptors_more']:+g} descriptors")
    if did.get("page", {}).get("mb_per_min", 0.0) > PAGE_MB_PER_MIN:
        found.append(f"the page grows by {did['page']['mb_per_min']} MB/min")
    return found


def write(row: dict[str, Any], report: Path = REPORT) -> None:
    """Judge a part's row and put it into the report, in the place of its last one."""
    row["wrong"] = wrong(row)
    row["verdict"] = "fail" if row["wrong"] else "pass"
    row["revision"] = revision()
    kept = report.with_suffix(".json")
    rows = {r["part"]: r for r in json.loads(kept.read_text())["rows"]} if kept.exists() else {}
    rows[row["part"]] = row
    ordered = [rows[part] for part in sorted(rows)]
    kept.write_text(json.dumps({"schema": "soak/1", "rows": ordered}, indent=1) + "\n")
    report.write_text(page(ordered))


def page(rows: list[dict[str, Any]]) -> str:
    """The report of these parts."""
    lines = [
        "# Long runs, and what they took",
        "",
        "`make soak` writes this page: `python -m tests.soak` says how.",
        "",
    ]
    for one in rows:
        lines += [f"## {one['part']}: {one['verdict']}", "", *(f"* Wrong: {what}" for what in one["wrong"])]
        lines += [f"* {one['minutes']} minutes at revision {one['revision']}, on {one['machine']}."]
        lines += ["* There was no door yet."] if one["processes"] and "deploy.door" not in one["processes"] else []
        lines += [f"* Done: {_words(one['did'])}."]
        lines += [f"* Summary: {_words(one['summary'])}."] if one["summary"] else []
        lines += [f"* Told: {trouble}." for trouble in one.get("troubles", ()) if one["wrong"]]
        lines += [f"* Left behind at the end: {_words(one['left'])}.", f"* Disk: {_words(one['disk'])}."]
        lines += [f"* Largest files [MB]: {_words(one['largest_mb'])}." if one["largest_mb"] else "", ""]
        lines += ["| process | MB/min | MB | descriptors | more than at first |", "| --- | --- | --- | --- | --- |"]
        lines += [
            f"| {name} | {t['mb_per_min']} | {t['mb']} | {t['descriptors']} | {t['descriptors_more']:+g} |"
            for name, t in one["processes"].items()
        ]
        lines.append("")
    return "\n".join(lines)


def _words(said: dict[str, Any]) -> str:
    parts = [f"{k.replace('_', ' ')} {f'({_words(v)})' if isinstance(v, dict) else v}" for k, v in said.items()]
    return ", ".join(parts).replace("[", "").replace("]", "").replace("'", "") or "nothing"
