"""Which functions equations may use: those that FMUs have on every platform, and no others."""

from dataclasses import replace

import pytest
import sympy
from sympy.printing.c import known_functions_C99

from fmu_plants import Equations, ModelError, Variable, export_fmu
from fmu_plants.export.ccode import callable_functions
from fmu_plants.pendulum import MODEL


class OnOneSystemOnly(sympy.Function):
    """Printed as a function of C's that is not in the standard, as a later SymPy might do."""

    def _ccode(self, printer):
        return f"j0({printer._print(self.args[0])})"


def test_whatever_sympy_has_a_c_function_for_may_be_used():
    printed = {name for name in known_functions_C99.values() if isinstance(name, str)}
    assert printed | {"fabs", "pow"} == callable_functions()


@pytest.mark.parametrize("platforms", [None, "linux-arm64", "windows-x86_64", "macos-arm64"])
@pytest.mark.parametrize(
    ("function", "name"),
    [
        (lambda x: sympy.besselj(0, x), "besselj"),
        (lambda x: 2 * OnOneSystemOnly(x) + 1, "j0"),
        (sympy.Function("friction"), "friction"),
        (lambda x: sympy.Integral(sympy.exp(-(x**2)), x), "Integral"),
    ],
)
def test_a_function_that_fmus_do_not_have_is_refused_by_name_on_every_platform(
    function, name, platforms, tmp_path
):
    model = replace(MODEL, equations=lambda v: Equations({"angle": function(v.angle), "angular_velocity": 0}))
    with pytest.raises(ModelError) as error:
        export_fmu(model, tmp_path / "pendulum.fmu", platforms=platforms)
    assert f"'pendulum': der(angle) uses the function {name}, which FMUs" in str(error.value)
    assert "in terms of these C functions: acos, acosh, asin" in str(error.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("formula", "where"),
    [
        (OnOneSystemOnly, "friction uses the function j0"),
        (sympy.loggamma, "d friction / d angle uses the function polygamma"),
    ],
)
def test_where_a_function_is_used_is_named(formula, where, tmp_path):
    model = replace(
        MODEL,
        outputs=(Variable("friction"),),
        equations=lambda v: Equations(MODEL.equations(v).derivatives, {"friction": formula(v.angle)}),
    )
    with pytest.raises(ModelError, match=where):
        export_fmu(model, tmp_path / "pendulum.fmu")
