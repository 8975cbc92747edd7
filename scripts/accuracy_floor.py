#!/usr/bin/env python3
"""Passes the table of `pickcell accuracy` through and compares it with the accuracy that is asked for.

    make --silent accuracy | scripts/accuracy_floor.py

Exit code 0: all is met; 1: something is not, each named; 2: there is no table.
"""

import sys

# Of the last row, over all sets: column, then the least (shares) or greatest (errors) values of its numbers.
LEAST = {"precision": 0.99, "recall 80 %": 0.99}
GREATEST = {"node mm 50 · 95 %": (0.28, 1.1), "grasp mm 50 · 95 %": (0.2, 0.8), "axis ° 50 · 95 %": (0.28, 1.5)}
# Of every row.
HEIGHT_MM_MAX = 0.2


def cells(line):
    return [c.strip() for c in line.strip().strip("|").split("|")]


def findings(heading, rows):
    rows = [dict(zip(heading, row, strict=True)) for row in rows]
    *sets, total = rows
    if "all" not in total["set"]:
        yield "the last row is not the one over all sets"
        return
    for column, least in LEAST.items():
        if not float(total[column]) >= least:
            yield f"{column} is {total[column]}, asked for: {least} or more"
    for column, greatest in GREATEST.items():
        for value, most in zip(total[column].split("·"), greatest, strict=True):
            if not float(value) <= most:
                yield f"{column} is {total[column]}, asked for: {greatest[0]} · {greatest[1]} or less"
                break
    for column in ("first pick", "nothing over it"):
        right, of = total[column].split("/")
        if right != of:
            yield f"{column}: {total[column]}"
    for row in sets:
        if row["parts"] == "0":
            if row["precision"] != "-":
                yield f"{row['set']}: something was found where nothing lies"
        elif not abs(float(row["height mm"])) < HEIGHT_MM_MAX:
            yield f"{row['set']}: mean height error {row['height mm']} mm, asked for: under {HEIGHT_MM_MAX}"


def main():
    lines = []
    for line in sys.stdin:
        print(line, end="", flush=True)
        if line.startswith("|") and not line.startswith("|-"):
            lines.append(cells(line))
    if len(lines) < 3:
        print("accuracy: no table came in", file=sys.stderr)
        return 2
    bad = list(findings(lines[0], lines[1:]))
    for finding in bad:
        print(f"accuracy: {finding}", file=sys.stderr)
    print("accuracy: " + ("below what is asked for" if bad else "all that is asked for is met"))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
