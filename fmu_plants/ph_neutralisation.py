r"""Neutralisation of an acid by a base in a stirred tank, with a buffer: a gain that varies by ten.

.. math::
    A h \, \dot W_a &= \sum_i q_i (W_{ai} - W_a), \qquad A h \, \dot W_b = \sum_i q_i (W_{bi} - W_b) \\
    A \dot h &= q_1 + q_2 + q_3 - C_v \sqrt{h} \\
    0 &= c(W_a, W_b, \mathrm{pH}) = W_a + 10^{\mathrm{pH} - 14} - 10^{-\mathrm{pH}}
         + W_b \frac{1 + 2 \cdot 10^{\mathrm{pH} - pK_2}}
                    {1 + 10^{pK_1 - \mathrm{pH}} + 10^{\mathrm{pH} - pK_2}}

with the flows :math:`q_1` of acid (HNO3), :math:`q_2` of buffer (NaHCO3) and :math:`q_3` of base (NaOH with
some NaHCO3), the level :math:`h`, and the reaction invariants of the tank: :math:`W_a` a balance of charges,
:math:`W_b` all carbonate. M. A. Henson, D. E. Seborg, "Adaptive nonlinear control of a pH neutralization
process", IEEE Trans. Control Systems Technology 2 (1994) 169-182, mixed ideally and without the dynamics of
valve and electrode; with the outlet as above also in their "Nonlinear Process Control", 1997, pages 207-210.
A = 207 cm2, C_v = 8.75 mL/s at 1 cm, pK_1 = 6.35, pK_2 = 10.25; acid, buffer and base have W_a = 3, -30 and
-3.05 mmol/L, and W_b = 0, 30 and 0.05 mmol/L.

It begins at the published point: pH 7 with 16.6, 0.55 and 15.6 mL/s. The equation for the pH is solved once,
for the start; from then on the pH is a state, such that c stays 0, or goes back there within T = 5 s:

.. math::
    \dot{\mathrm{pH}} = -\left(\frac{\partial c}{\partial W_a} \dot W_a
                               + \frac{\partial c}{\partial W_b} \dot W_b
                               + \frac{c}{T}\right) \Big/ \frac{\partial c}{\partial \mathrm{pH}}
"""

from fmu_plants import Equations, Parameter, PlantModel, Symbols, Variable, tunable

AREA, OUTLET = 207.0, 8.75  # cm2, mL/s at a level of 1 cm
PK = (6.35, 10.25)
BALANCING_TIME = 5.0  # s
FLOWS = {"acid": 16.6, "buffer": 0.55, "base": 15.6}  # mL/s
CHARGES = {"acid": 3.0, "buffer": -30.0, "base": -3.05}  # mmol/L: W_a of each flow
CARBONATES = {"acid": 0.0, "buffer": 30.0, "base": 0.05}  # mmol/L: W_b
TOTAL_FLOW = sum(FLOWS.values())


def _mixed(invariants: dict[str, float]) -> float:
    """Return an invariant of the tank at rest [mmol/L]."""
    return sum(flow * invariants[name] for name, flow in FLOWS.items()) / TOTAL_FLOW


def _charge(charge: float, carbonate: float, ph: float) -> float:
    """Return c [mmol/L], which rises with the pH."""
    share = (1 + 2 * 10 ** (ph - PK[1])) / (1 + 10 ** (PK[0] - ph) + 10 ** (ph - PK[1]))
    return charge + 1e3 * (10 ** (ph - 14) - 10**-ph) + carbonate * share


def _ph_at_rest() -> float:
    """Return the pH at which the charges balance, by bisection."""
    low, high = 0.0, 14.0
    while (middle := (low + high) / 2) not in (low, high):
        balanced = _charge(START_CHARGE, START_CARBONATE, middle) > 0
        low, high = (low, middle) if balanced else (middle, high)
    return middle


START_CHARGE, START_CARBONATE = _mixed(CHARGES), _mixed(CARBONATES)

CHARGE = Variable("charge", "mmol/L", nominal=1.0, start=START_CHARGE, description="Reaction invariant W_a")
CARBONATE = Variable(
    "carbonate", "mmol/L", 0.0, nominal=1.0, start=START_CARBONATE, description="Reaction invariant W_b"
)
LEVEL = Variable(
    "level",
    "cm",
    0.0,
    40.0,
    nominal=10.0,
    start=(TOTAL_FLOW / OUTLET) ** 2,
    description="Level h in the tank",
)
PH = Variable("pH", "", 0.0, 14.0, nominal=1.0, start=_ph_at_rest(), description="pH in the tank")
BASE, ACID, BUFFER = (
    Variable(
        f"{name}_flow",
        "mL/s",
        0.0,
        high,
        nominal=nominal,
        start=FLOWS[name],
        description=f"Flow {symbol} of the {name}",
    )
    for name, symbol, high, nominal in (
        ("base", "q_3", 30.0, 10.0),
        ("acid", "q_1", 30.0, 10.0),
        ("buffer", "q_2", 5.0, 1.0),
    )
)


def equations(v: Symbols) -> Equations:
    """Return the right-hand side above."""
    from sympy import Integer, sqrt  # reading the plant's variables must not cost SymPy's import

    flows = {name: v[f"{name}_flow"] for name in FLOWS}
    volume = v.area * v.level
    charge, carbonate = (
        sum(flow * (v[f"{name}_{kind}"] - v[kind]) for name, flow in flows.items()) / volume
        for kind in ("charge", "carbonate")
    )
    ph, ten = v.pH, Integer(10)
    share = (1 + 2 * ten ** (ph - v.pK_2)) / (1 + ten ** (v.pK_1 - ph) + ten ** (ph - v.pK_2))
    balance = v.charge + 1000 * (ten ** (ph - 14) - ten ** (-ph)) + v.carbonate * share
    return Equations(
        {
            "charge": charge,
            "carbonate": carbonate,
            "level": (sum(flows.values()) - v.outlet * sqrt(v.level)) / v.area,
            "pH": -(charge + share * carbonate + balance / BALANCING_TIME) / balance.diff(ph),
        }
    )


MODEL = PlantModel(
    name="ph_neutralisation",
    description="Neutralisation of an acid in a stirred tank",
    source=(
        "M. A. Henson, D. E. Seborg, IEEE Trans. Control Systems Technology 2 (1994) 169-182, without valve "
        "and electrode dynamics"
    ),
    states=(CHARGE, CARBONATE, LEVEL, PH),
    inputs=(BASE, ACID, BUFFER),
    outputs=(PH, LEVEL),
    parameters=(
        Parameter("area", "cm2", 1e-3, start=AREA, nominal=100.0, description="Area A of the tank"),
        tunable(
            "outlet", "mL/s", 0.0, start=OUTLET, description="Flow C_v through the outlet at a level of 1 cm"
        ),
        *(
            Parameter(f"pK_{i}", "", start=value, description=f"pK_{i} of carbonic acid")
            for i, value in enumerate(PK, 1)
        ),
        *(
            tunable(
                f"{name}_{kind}",
                "mmol/L",
                start=value,
                description=f"Reaction invariant {symbol} of the {name}",
            )
            for kind, symbol, values in (("charge", "W_a", CHARGES), ("carbonate", "W_b", CARBONATES))
            for name, value in values.items()
        ),
    ),
    equations=equations,
    step_size=15.0,
    stop_time=1500.0,
)
