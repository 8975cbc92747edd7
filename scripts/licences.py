#!/usr/bin/env python3
"""Compares the licence of every dependency in Cargo.lock with the list in deny.toml.

Exit code 0: all are allowed; 1: some are not, or come from elsewhere than the registry, each named with the remedy.
"""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def is_allowed(expression, allowed):
    """Evaluates an SPDX expression; crates of old write / for OR. AND binds more tightly than OR."""
    tokens = re.findall(r"[()]|[^\s()]+", expression.replace("/", " OR "))

    def either():
        value = both()
        while tokens and tokens[0] == "OR":
            tokens.pop(0)
            value = both() or value
        return value

    def both():
        value = one()
        while tokens and tokens[0] == "AND":
            tokens.pop(0)
            value = one() and value
        return value

    def one():
        name = tokens.pop(0)
        if name == "(":
            value = either()
            tokens.pop(0)
            return value
        if tokens[:1] == ["WITH"]:
            name = f"{name} WITH {tokens[1]}"
            del tokens[:2]
        return name in allowed

    return either()


def main():
    rules = tomllib.loads((ROOT / "deny.toml").read_text())["licenses"]
    exceptions = {e["crate"]: set(e["allow"]) for e in rules.get("exceptions", [])}
    command = ["cargo", "metadata", "--format-version", "1", "--locked"]
    metadata = json.loads(subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout)
    own = set(metadata["workspace_members"])
    bad = []
    for package in metadata["packages"]:
        name = f"{package['name']} {package['version']}"
        allowed = set(rules["allow"]) | exceptions.get(package["name"], set())
        if not package["license"]:
            bad.append(f"{name} names no licence: read its licence file, take another crate, or write an exception")
        elif not is_allowed(package["license"], allowed):
            bad.append(f"{name} is under {package['license']}: take another crate, or allow it in deny.toml")
        if package["id"] not in own and not (package["source"] or "").startswith("registry+"):
            bad.append(f"{name} comes from {package['source'] or 'a path'}: take it from the registry")
    for line in bad:
        print(f"licences: {line}", file=sys.stderr)
    if not bad:
        print(f"licences: {len(metadata['packages'])} packages, all allowed by deny.toml")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
