"""Draw the order of coupled FMUs: run ``python docs/scripts/draw_orders.py``."""

import ast
from pathlib import Path

DOCS = Path(__file__).parents[1]


def main() -> None:
    """Run the example, and save the chart that it ends with."""
    tree = ast.parse((DOCS / "examples" / "couple_two_masses.py").read_text(encoding="utf-8"))
    chart = ast.Expression(tree.body.pop().value)  # type: ignore[attr-defined]
    names: dict[str, object] = {}
    exec(compile(tree, "example", "exec"), names)
    print(names["orders"])
    eval(compile(chart, "example", "eval"), names).save(
        DOCS / "pictures" / "coupling-orders.png", scale_factor=2
    )


if __name__ == "__main__":
    main()
