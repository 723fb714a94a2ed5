"""Thirty plants as suppliers name and deliver them, and what an engineer would have `init` answer to each.

What is expected is taken from the equations by hand: steady states as formulas, time constants of the
linearised equations. Nothing of it comes from what `init` says.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import brentq

from fmu_plants import Equations, Parameter, PlantModel, Symbols, Variable

DAY, HOUR = 86400.0, 3600.0
GRAVITY = 9.81
COMFORT = (283.15, 308.15)
"""Where people stay in a room [K]."""
Levels = Mapping[str, float]
Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Delivery:
    """A supplier's FMU and the answers to it that are right.

    Parameters
    ----------
    model : PlantModel
        Its equations, whose names are identifiers.
    spelt : mapping of str to str
        Names of the FMU that are no identifiers, by those of the model; below stand those of the FMU.
    fmi : str
        Version of the standard.
    driven : tuple of frozenset of str
        Sets of inputs that may be driven.
    controlled : tuple of frozenset of str
        Sets of outputs that may be controlled.
    disturbances, may_disturb : frozenset of str
        Inputs that have to be disturbances, and that may be some as well.
    steady : callable
        The outputs at rest for levels of all inputs, by name.
    ends : mapping of str to (float, float)
        How far inputs that may be driven can plausibly go.
    plausible : mapping of str to (float, float)
        Where setpoints make sense, whatever the inputs could do.
    levels : mapping of str to (float, float)
        Where inputs have to start.
    constants : (float, float), optional
        The shortest and the longest time constant that may be called the dominant one [s].
    sampling : (float, float), optional
        Where there is none: the sampling times that make sense [s].
    period : float, optional
        After which the plant at rest repeats itself [s].
    told : tuple of str
        What has to be said, on the terminal or in the study: patterns of which each has to be there.
    is_controller : bool
        Whether there is no plant to control: it is told, and the rest does not matter.
    is_unstable : bool
        Whether no recording in open loop makes sense.
    """

    model: PlantModel
    spelt: Mapping[str, str] = field(default_factory=dict)
    fmi: str = "2.0"
    driven: tuple[frozenset[str], ...] = ()
    controlled: tuple[frozenset[str], ...] = ()
    disturbances: frozenset[str] = frozenset()
    may_disturb: frozenset[str] = frozenset()
    steady: Callable[[Levels], Levels] | None = None
    ends: Mapping[str, Range] = field(default_factory=dict)
    plausible: Mapping[str, Range] = field(default_factory=dict)
    levels: Mapping[str, Range] = field(default_factory=dict)
    constants: Range | None = None
    sampling: Range | None = None
    period: float | None = None
    told: tuple[str, ...] = ()
    is_controller: bool = False
    is_unstable: bool = False


def sets(*names: str) -> tuple[frozenset[str], ...]:
    """Return sets of signals, each written with commas."""
    return tuple(frozenset(text.split(",")) for text in names)


def one(constant: float) -> Range:
    """Return a time constant as the only one that may be called dominant."""
    return constant, constant


def time_constants(matrix: Iterable[Iterable[float]]) -> NDArray[np.float64]:
    """Return the time constants of a stable linear system in growing order [s], shape (n,)."""
    return np.sort(-1.0 / np.linalg.eigvals(np.array(matrix)).real)


def rise_time(a: Any, b: Any, c: Any) -> float:
    """Return when the step response of a linear system has first covered 63 % of its way [s]."""
    a, b, c = np.array(a), np.array(b), np.array(c)
    final = -c @ np.linalg.solve(a, b)

    def missing(t: float) -> float:
        risen = c @ np.linalg.solve(a, (expm(a * t) - np.eye(len(a))) @ b)
        return float(risen / final - (1.0 - math.exp(-1.0)))

    return float(brentq(missing, 0.0, 10.0 * time_constants(a)[-1]))


V = Variable


def temperature(name: str, start: float = 293.15, description: str = "") -> Variable:
    return V(name, "K", start=start, description=description)


# A zone with heavy walls, in the weather.


_ZONE, _WALLS = 5e6, 4e7  # J/K
_INSIDE, _OUTSIDE, _WINDOWS, _GLASS = 300.0, 90.0, 60.0, 4.0  # W/K, m2
_THROUGH = _WINDOWS + _INSIDE * _OUTSIDE / (_INSIDE + _OUTSIDE)
_ZONE_MATRIX = [
    [-(_INSIDE + _WINDOWS) / _ZONE, _INSIDE / _ZONE],
    [_INSIDE / _WALLS, -(_INSIDE + _OUTSIDE) / _WALLS],
]


def _zone(v: Symbols) -> Equations:
    to_wall = _INSIDE * (v.T_zone_K - v.T_wall_K)
    loss = _WINDOWS * (v.T_zone_K - v.T_amb_K)
    return Equations(
        {
            "T_zone_K": (v.Pth_W - to_wall - loss + _GLASS * v.HGloHor_Wm2) / _ZONE,
            "T_wall_K": (to_wall - _OUTSIDE * (v.T_wall_K - v.T_amb_K)) / _WALLS,
        }
    )


ZONE = Delivery(
    model=PlantModel(
        name="TestCellZone",
        equations=_zone,
        states=(temperature("T_zone_K"), temperature("T_wall_K", 278.15 + 15.0 * _INSIDE / 390.0)),
        inputs=(
            temperature("T_amb_K", 278.15, "Ambient dry bulb temperature"),
            V("HGloHor_Wm2", "W/m2", 0.0, description="Global horizontal irradiation"),
            V("Pth_W", "W", 0.0, 4500.0, start=15.0 * _THROUGH),
        ),
        outputs=(temperature("T_zone_K"),),
        step_size=900.0,
        stop_time=14 * DAY,
    ),
    driven=sets("Pth_W"),
    controlled=sets("T_zone_K"),
    disturbances=frozenset({"T_amb_K", "HGloHor_Wm2"}),
    steady=lambda u: {
        "T_zone_K": u["T_amb_K"] + (u["Pth_W"] + _GLASS * u["HGloHor_Wm2"]) / _THROUGH,
    },
    ends={"Pth_W": (0.0, 4500.0)},
    plausible={"T_zone_K": COMFORT},
    constants=(float(time_constants(_ZONE_MATRIX)[0]), rise_time(_ZONE_MATRIX, [1.0, 0.0], [1.0, 0.0])),
)


# A heating coil in an air handling unit; degrees Celsius, and a stop time that says nothing.

_COIL, _COIL_AIR, _COIL_WATER = 1.8e5, 1207.0, 900.0  # J/K, W/K


def _coil_at(u: Levels) -> float:
    water = _COIL_WATER * u["ctl.yVal"]
    return (water * u["TWatSup_degC"] + _COIL_AIR * u["TOutAir_degC"]) / (water + _COIL_AIR)


COIL = Delivery(
    model=PlantModel(
        name="AHU_HeatingCoil",
        equations=lambda v: Equations(
            {
                "TAirLvg_degC": (
                    _COIL_WATER * v.ctl_yVal * (v.TWatSup_degC - v.TAirLvg_degC)
                    - _COIL_AIR * (v.TAirLvg_degC - v.TOutAir_degC)
                )
                / _COIL
            }
        ),
        states=(V("TAirLvg_degC", "degC", start=27635.0 / 1567.0),),
        inputs=(
            V("ctl_yVal", "", 0.0, 1.0, start=0.4, description="Valve position"),
            V("TWatSup_degC", "degC", start=60.0, description="Water supply temperature"),
            V("TOutAir_degC", "degC", start=5.0),
        ),
        outputs=(V("TAirLvg_degC", "degC", start=27635.0 / 1567.0),),
        stop_time=10.0,
    ),
    spelt={"ctl_yVal": "ctl.yVal"},
    fmi="3.0",
    driven=sets("ctl.yVal", "ctl.yVal,TWatSup_degC"),
    controlled=sets("TAirLvg_degC"),
    disturbances=frozenset({"TOutAir_degC"}),
    may_disturb=frozenset({"TWatSup_degC"}),
    steady=lambda u: {"TAirLvg_degC": _coil_at(u)},
    ends={"ctl.yVal": (0.0, 1.0), "TWatSup_degC": (30.0, 80.0)},
    plausible={"TAirLvg_degC": (0.0, 50.0)},
    constants=one(_COIL / (_COIL_AIR + 0.4 * _COIL_WATER)),
)


# A tank that runs out below, and that somebody draws from.

_TANK, _HOLE, _FULL = 1.2, 3e-3, 3.0  # m2, m2, m
_TANK_LEVEL = 1.2  # m


def _tank(v: Symbols) -> Equations:
    from sympy import Max, sqrt

    out = _HOLE * sqrt(2 * GRAVITY * Max(v.hLev_m, 0.0))
    return Equations({"hLev_m": (v.VFlowIn - v.VFlowDemand - out) / _TANK})


def _level(inflow: float, hole: float) -> float:
    """Return the level [m] at which a tank lets out what comes in [m3/s]."""
    return (max(inflow, 0.0) / hole) ** 2 / (2 * GRAVITY)


def _tank_constant(level: float, area: float, hole: float) -> float:
    return area / (hole * math.sqrt(GRAVITY / (2 * level)))


TANK = Delivery(
    model=PlantModel(
        name="ReceiverTank_B12",
        equations=_tank,
        states=(V("hLev_m", "m", 0.0, _FULL, start=_TANK_LEVEL),),
        inputs=(
            V("VFlowIn", "m3/s", 0.0, 0.025, start=2e-3 + _HOLE * math.sqrt(2 * GRAVITY * _TANK_LEVEL)),
            V("VFlowDemand", "m3/s", 0.0, start=2e-3, description="Draw-off by consumers"),
        ),
        outputs=(V("hLev_m", "m", 0.0, _FULL, start=_TANK_LEVEL),),
        stop_time=3600.0,
    ),
    driven=sets("VFlowIn"),
    controlled=sets("hLev_m"),
    disturbances=frozenset({"VFlowDemand"}),
    steady=lambda u: {"hLev_m": _level(u["VFlowIn"] - u["VFlowDemand"], _HOLE)},
    ends={"VFlowIn": (0.0, 0.025)},
    plausible={"hLev_m": (0.0, _FULL)},
    constants=one(_tank_constant(_TANK_LEVEL, _TANK, _HOLE)),
)


# Neutralisation in a stirred tank: charge balance, and a titration curve that a buffer makes mild.

_STIRRED, _LYE, _BUFFER = 50.0, 0.02, 1e-3  # L, mol/L, mol/L


def _titration(v: Symbols) -> Equations:
    from sympy import asinh, log

    inflow = _LYE * (v.FAlk_Ls - v.FWaste_Ls)
    return Equations(
        {"xi": (inflow - (v.FAlk_Ls + v.FWaste_Ls) * v.xi) / _STIRRED},
        {"AI401_pH": 7 + asinh(v.xi / (2 * _BUFFER)) / log(10)},
    )


def _ph(u: Levels) -> float:
    charge = _LYE * (u["FAlk_Ls"] - u["FWaste_Ls"]) / (u["FAlk_Ls"] + u["FWaste_Ls"])
    return 7 + math.asinh(charge / (2 * _BUFFER)) / math.log(10)


NEUTRALISATION = Delivery(
    model=PlantModel(
        name="NeutralisationR2",
        equations=_titration,
        states=(V("xi", "mol/L", nominal=1e-3, start=_LYE * 0.02 / 0.42),),
        inputs=(
            V("FAlk_Ls", "L/s", 0.0, 0.5, start=0.22, description="Sodium hydroxide"),
            V("FWaste_Ls", "L/s", 0.0, 1.0, start=0.2, description="Waste water inflow"),
        ),
        outputs=(V("AI401_pH", "", 0.0, 14.0),),
        stop_time=1800.0,
    ),
    driven=sets("FAlk_Ls"),
    controlled=sets("AI401_pH"),
    disturbances=frozenset({"FWaste_Ls"}),
    steady=lambda u: {"AI401_pH": _ph(u)},
    ends={"FAlk_Ls": (0.0, 0.5)},
    constants=one(_STIRRED / 0.42),
)


# A chemostat by Monod's law: what is fed is all that grows.

_GROWTH, _HALF, _YIELD = 0.4, 2.0, 0.5  # 1/h, g/L
_DILUTION, _FEED = 0.2, 20.0  # 1/h, g/L


def _sugar(dilution: float) -> float:
    return _HALF * dilution / (_GROWTH - dilution)


def _chemostat(v: Symbols) -> Equations:
    growth = _GROWTH * v.SGlu_gL / (_HALF + v.SGlu_gL)
    return Equations(
        {
            "XBio_gL": (growth - v.DRate_1h) * v.XBio_gL / HOUR,
            "SGlu_gL": (v.DRate_1h * (v.SFeed_gL - v.SGlu_gL) - growth * v.XBio_gL / _YIELD) / HOUR,
        }
    )


_SUGAR = _sugar(_DILUTION)
_BIOMASS = V("XBio_gL", "g/L", 0.0, start=_YIELD * (_FEED - _SUGAR), description="Biomass")
_GLUCOSE = V("SGlu_gL", "g/L", 0.0, start=_SUGAR, description="Residual glucose")

CHEMOSTAT = Delivery(
    model=PlantModel(
        name="Fermenter_Chemostat",
        equations=_chemostat,
        states=(_BIOMASS, _GLUCOSE),
        inputs=(
            V("DRate_1h", "1/h", 0.0, 0.35, start=_DILUTION, description="Dilution rate"),
            V("SFeed_gL", "g/L", 0.0, start=_FEED, description="Glucose in the feed"),
        ),
        outputs=(_BIOMASS, _GLUCOSE),
        stop_time=100 * HOUR,
    ),
    driven=sets("DRate_1h"),
    controlled=sets("XBio_gL", "SGlu_gL"),
    disturbances=frozenset({"SFeed_gL"}),
    steady=lambda u: {
        "XBio_gL": _YIELD * (u["SFeed_gL"] - _sugar(u["DRate_1h"])),
        "SGlu_gL": _sugar(u["DRate_1h"]),
    },
    ends={"DRate_1h": (0.0, 0.35)},
    plausible={"XBio_gL": (0.0, 10.0), "SGlu_gL": (0.0, 20.0)},
    # The total of sugar and biomass, which takes 1/D, does not change with D.
    constants=one(HOUR * (_HALF + _SUGAR) ** 2 / (_GROWTH * _HALF * (_FEED - _SUGAR))),
)


# Fish that are caught, to the logistic law.

_BIRTH, _CAPACITY, _CATCH = 0.05 / DAY, 8000.0, 1e-3 / DAY  # 1/s, 1, 1/s


def _stock(effort: float) -> float:
    return max(_CAPACITY * (1 - _CATCH * effort / _BIRTH), 0.0)


_FISH = V("nFish", "", 0.0, start=_stock(30.0))

FISHERY = Delivery(
    model=PlantModel(
        name="StockModel",
        equations=lambda v: Equations(
            {"nFish": v.nFish * (_BIRTH * (1 - v.nFish / _CAPACITY) - _CATCH * v.fleetEff)}
        ),
        states=(_FISH,),
        inputs=(V("fleetEff", "", start=30.0, description="Boats at sea"),),
        outputs=(_FISH,),
        step_size=DAY,
        stop_time=3650 * DAY,
    ),
    driven=sets("fleetEff"),
    controlled=sets("nFish"),
    steady=lambda u: {"nFish": _stock(u["fleetEff"])},
    ends={"fleetEff": (0.0, 60.0)},
    plausible={"nFish": (0.0, _CAPACITY)},
    constants=one(1 / (_BIRTH - 30.0 * _CATCH)),
)


# A stirred reactor, exothermic, stable everywhere; the temperature of its jacket is what one has.

_REACTOR, _THROUGHPUT, _JACKET = 4e6, 0.01, 4e4  # J/K (of 1 m3), m3/s, W/K
_HEAT, _ARRHENIUS, _HOT = 5e4, 6000.0, 330.0  # J/mol, K, K
_RATE = 0.01 * math.exp(_ARRHENIUS / _HOT)  # 1/s


def _reactor(v: Symbols) -> Equations:
    from sympy import exp

    reaction = _RATE * exp(-_ARRHENIUS / v.TReac_K) * v.cA_molm3
    feed = _THROUGHPUT * _REACTOR * (v.TFeed_K - v.TReac_K)
    return Equations(
        {
            "TReac_K": (_HEAT * reaction + feed + _JACKET * (v.TJac_K - v.TReac_K)) / _REACTOR,
            "cA_molm3": _THROUGHPUT * (v.cFeed_molm3 - v.cA_molm3) - reaction,
        }
    )


def _reactor_at(u: Levels) -> dict[str, float]:
    def left(temperature: float) -> float:
        return _THROUGHPUT * u["cFeed_molm3"] / (_THROUGHPUT + _RATE * math.exp(-_ARRHENIUS / temperature))

    def heating(temperature: float) -> float:
        reacting = _THROUGHPUT * (u["cFeed_molm3"] - left(temperature))
        feed = _THROUGHPUT * _REACTOR * (u["TFeed_K"] - temperature)
        return _HEAT * reacting + feed + _JACKET * (u["TJac_K"] - temperature)

    temperature = float(brentq(heating, 200.0, 500.0))
    return {"TReac_K": temperature, "cA_molm3": left(temperature)}


_FASTER = 0.01 * _ARRHENIUS / _HOT**2  # 1/(s.K), of the rate at 330 K
_REACTOR_MATRIX = [
    [(_HEAT * 500.0 * _FASTER - _THROUGHPUT * _REACTOR - _JACKET) / _REACTOR, _HEAT * 0.01 / _REACTOR],
    [-500.0 * _FASTER, -_THROUGHPUT - 0.01],
]
_REACTING = temperature("TReac_K", _HOT)
_REACTANT = V("cA_molm3", "mol/m3", 0.0, start=500.0)

REACTOR = Delivery(
    model=PlantModel(
        name="R101_Reactor",
        equations=_reactor,
        states=(_REACTING, _REACTANT),
        inputs=(
            temperature("TFeed_K", 325.0, "Feed temperature"),
            V("cFeed_molm3", "mol/m3", 0.0, start=1000.0, description="Feed concentration"),
            V("TJac_K", "K", 300.0, 350.0, start=328.75, description="Jacket temperature"),
        ),
        outputs=(_REACTING, _REACTANT),
        stop_time=1000.0,
    ),
    fmi="3.0",
    driven=sets("TJac_K"),
    controlled=sets("TReac_K", "cA_molm3"),
    disturbances=frozenset({"TFeed_K", "cFeed_molm3"}),
    steady=_reactor_at,
    ends={"TJac_K": (300.0, 350.0)},
    plausible={"TReac_K": (290.0, 370.0), "cA_molm3": (0.0, 1000.0)},
    constants=(
        float(time_constants(_REACTOR_MATRIX)[0]),
        max(
            float(time_constants(_REACTOR_MATRIX)[-1]),
            rise_time(_REACTOR_MATRIX, [1.0, 0.0], [0.0, 1.0]),
        ),
    ),
)


# A motor under a load.

_OHM, _FLUX, _INERTIA, _FRICTION, _HENRY = 1.2, 0.06, 2e-4, 1e-5, 1e-3  # SI


def _speed(u: Levels) -> float:
    drive = _FLUX * u["uArm_V"] - _OHM * u["MLoad_Nm"]
    return drive / (_FLUX**2 + _OHM * _FRICTION)


_MOTOR_REST = {"uArm_V": 12.0, "MLoad_Nm": 0.1}
_CURRENT = V("iArm_A", "A", start=(0.1 + _FRICTION * _speed(_MOTOR_REST)) / _FLUX)
_MOTOR_SPEED = V("wMot", "rad/s", start=_speed(_MOTOR_REST))

MOTOR = Delivery(
    model=PlantModel(
        name="EC45_flat",
        equations=lambda v: Equations(
            {
                "iArm_A": (v.uArm_V - _OHM * v.iArm_A - _FLUX * v.wMot) / _HENRY,
                "wMot": (_FLUX * v.iArm_A - _FRICTION * v.wMot - v.MLoad_Nm) / _INERTIA,
            }
        ),
        states=(_CURRENT, _MOTOR_SPEED),
        inputs=(V("uArm_V", "V", -24.0, 24.0, start=12.0), V("MLoad_Nm", "N.m", start=0.1)),
        outputs=(_CURRENT, _MOTOR_SPEED),
        stop_time=1.0,
    ),
    driven=sets("uArm_V"),
    controlled=sets("wMot"),
    disturbances=frozenset({"MLoad_Nm"}),
    steady=lambda u: {"wMot": _speed(u)},
    ends={"uArm_V": (-24.0, 24.0)},
    constants=one(_INERTIA * _OHM / (_FLUX**2 + _OHM * _FRICTION)),
)


# A boiler: what it burns, and a turbine's valve.

_BOILER, _VALVE, _STEAM = 2000.0, 20.0 / 3e6, 2e6  # J/Pa, kg/(s.Pa), J/kg
_DRUM = V("pDrum_Pa", "Pa", start=6e6)


def _boiler_at(u: Levels) -> dict[str, float]:
    pressure = u["QFuel_W"] / (_STEAM * _VALVE * u["yTurVal"])
    return {"pDrum_Pa": pressure, "mSte_kgs": u["QFuel_W"] / _STEAM}


BOILER = Delivery(
    model=PlantModel(
        name="SteamGen",
        equations=lambda v: Equations(
            {"pDrum_Pa": (v.QFuel_W - _STEAM * _VALVE * v.yTurVal * v.pDrum_Pa) / _BOILER},
            {"mSte_kgs": _VALVE * v.yTurVal * v.pDrum_Pa},
        ),
        states=(_DRUM,),
        inputs=(
            V("QFuel_W", "W", 0.0, 8e7, start=4e7, description="Fuel power"),
            V("yTurVal", "", 0.2, 1.0, start=0.5, description="Turbine valve"),
        ),
        outputs=(_DRUM, V("mSte_kgs", "kg/s")),
        stop_time=7200.0,
    ),
    driven=sets("QFuel_W", "QFuel_W,yTurVal"),
    controlled=sets("pDrum_Pa", "mSte_kgs", "pDrum_Pa,mSte_kgs"),
    may_disturb=frozenset({"yTurVal"}),
    steady=_boiler_at,
    ends={"QFuel_W": (0.0, 8e7), "yTurVal": (0.2, 1.0)},
    plausible={"pDrum_Pa": (0.0, 15e6), "mSte_kgs": (0.0, 40.0)},
    constants=one(_BOILER / (_STEAM * _VALVE * 0.5)),
)


# A hydraulic cylinder against an outer force; compressible oil.

_MASS, _PISTON, _OIL, _LEAK, _VISCOUS, _SPOOL = 500.0, 2e-3, 4.2e-13, 6e-11, 8e3, 1e-3  # SI


def _piston(u: Levels) -> dict[str, float]:
    flow = _SPOOL * u["uSpool"] - _LEAK * u["FExt_N"] / _PISTON
    speed = flow / (_PISTON + _LEAK * _VISCOUS / _PISTON)
    return {"vPis_ms": speed, "pL_Pa": (_VISCOUS * speed + u["FExt_N"]) / _PISTON}


_PISTON_REST = _piston({"uSpool": 0.3, "FExt_N": 2000.0})
_STROKE = V("vPis_ms", "m/s", start=_PISTON_REST["vPis_ms"])
_LOAD_PRESSURE = V("pL_Pa", "Pa", nominal=1e6, start=_PISTON_REST["pL_Pa"], description="Load pressure")
_OIL_SPRING = math.sqrt((_PISTON**2 + _LEAK * _VISCOUS) / (_MASS * _OIL))  # rad/s

CYLINDER = Delivery(
    model=PlantModel(
        name="CylinderDrive",
        equations=lambda v: Equations(
            {
                "vPis_ms": (_PISTON * v.pL_Pa - _VISCOUS * v.vPis_ms - v.FExt_N) / _MASS,
                "pL_Pa": (_SPOOL * v.uSpool - _PISTON * v.vPis_ms - _LEAK * v.pL_Pa) / _OIL,
            }
        ),
        states=(_STROKE, _LOAD_PRESSURE),
        inputs=(
            V("uSpool", "", -1.0, 1.0, start=0.3),
            V("FExt_N", "N", start=2000.0, description="External force"),
        ),
        outputs=(_STROKE, _LOAD_PRESSURE),
        stop_time=0.5,
    ),
    driven=sets("uSpool"),
    controlled=sets("vPis_ms", "pL_Pa"),
    disturbances=frozenset({"FExt_N"}),
    steady=_piston,
    ends={"uSpool": (-1.0, 1.0)},
    constants=(1 / _OIL_SPRING, 2 / _OIL_SPRING),
)


# A battery cell: charge that adds up, and a voltage that follows.

_AMPERE_HOURS, _R0, _R1, _RELAXING = 100.0, 1e-3, 5e-4, 30.0  # Ah, Ohm, Ohm, s


BATTERY = Delivery(
    model=PlantModel(
        name="LFP_Cell_100Ah",
        equations=lambda v: Equations(
            {
                "SOC": v.iBat_A / (HOUR * _AMPERE_HOURS),
                "uRC": (_R1 * v.iBat_A - v.uRC) / _RELAXING,
            },
            {"uTer_V": 3.4 + 0.7 * v.SOC + _R0 * v.iBat_A + v.uRC},
        ),
        states=(V("SOC", "", 0.0, 1.0, start=0.5), V("uRC", "V")),
        inputs=(V("iBat_A", "A", -100.0, 100.0, description="Charging current"),),
        outputs=(V("SOC", "", 0.0, 1.0, start=0.5), V("uTer_V", "V")),
        stop_time=HOUR,
    ),
    driven=sets("iBat_A"),
    controlled=sets("SOC", "uTer_V"),
    plausible={"SOC": (0.0, 1.0), "uTer_V": (3.25, 4.25)},
    sampling=(1.0, HOUR / 5),  # it relaxes in 30 s, and is charged in an hour
    told=("integrat",),
)


# A car on a road.

_CAR, _DRAG, _ROLLING = 1500.0, 0.39, 0.01  # kg, kg/m, 1
_WEIGHT = _CAR * GRAVITY


def _car(v: Symbols) -> Equations:
    from sympy import Abs, sin, tanh

    air = v.vCar_ms + v.vWind_ms
    resistance = _DRAG * air * Abs(air) + _ROLLING * _WEIGHT * tanh(v.vCar_ms / 0.1)
    return Equations({"vCar_ms": (v.FTrac_N - resistance - _WEIGHT * sin(v.alpRoad_rad)) / _CAR})


def _cruising(u: Levels) -> float:
    left = u["FTrac_N"] - _WEIGHT * (_ROLLING + math.sin(u["alpRoad_rad"]))
    return max(math.sqrt(max(left, 0.0) / _DRAG) - u["vWind_ms"], 0.0)


_CRUISE = V("vCar_ms", "m/s", start=25.0, description="Vehicle speed")

CAR = Delivery(
    model=PlantModel(
        name="LongitudinalDynamics",
        equations=_car,
        states=(_CRUISE,),
        inputs=(
            V("FTrac_N", "N", 0.0, 2000.0, start=_DRAG * 625.0 + _ROLLING * _WEIGHT),
            V("alpRoad_rad", "rad", description="Road slope"),
            V("vWind_ms", "m/s", description="Head wind"),
        ),
        outputs=(_CRUISE,),
        stop_time=100.0,
    ),
    driven=sets("FTrac_N"),
    controlled=sets("vCar_ms"),
    disturbances=frozenset({"alpRoad_rad", "vWind_ms"}),
    steady=lambda u: {"vCar_ms": _cruising(u)},
    ends={"FTrac_N": (0.0, 2000.0)},
    plausible={"vCar_ms": (0.0, 80.0)},
    constants=one(_CAR / (2 * _DRAG * 25.0)),
)


# A pump that is switched off at first, and has a speed.

_SUMP, _DRAIN, _PUMPED = 0.5, 1e-3, 6e-3  # m2, m2, m3/s


def _sump(v: Symbols) -> Equations:
    from sympy import Max, sqrt

    out = _DRAIN * sqrt(2 * GRAVITY * Max(v.LT1_m, 0.0))
    return Equations({"LT1_m": (_PUMPED * v.pmp1_on * v.pmp1_nSpd - out) / _SUMP})


_SUMP_LEVEL = V("LT1_m", "m", 0.0, start=0.3, description="Level transmitter")

PUMP = Delivery(
    model=PlantModel(
        name="PumpStationWest",
        equations=_sump,
        states=(_SUMP_LEVEL,),
        inputs=(
            V("pmp1_on", "", 0.0, 1.0, description="Pump on/off"),
            V("pmp1_nSpd", "", 0.0, 1.0, start=0.6, description="Relative speed"),
        ),
        outputs=(_SUMP_LEVEL,),
        stop_time=HOUR,
    ),
    spelt={"pmp1_on": "pmp1.on", "pmp1_nSpd": "pmp1.nSpd"},
    driven=sets("pmp1.nSpd"),
    controlled=sets("LT1_m"),
    steady=lambda u: {"LT1_m": _level(_PUMPED * u["pmp1.on"] * u["pmp1.nSpd"], _DRAIN)},
    ends={"pmp1.nSpd": (0.0, 1.0)},
    levels={"pmp1.on": (1.0, 1.0)},
    constants=one(_tank_constant(_level(0.6 * _PUMPED, _DRAIN), _SUMP, _DRAIN)),
    told=(r"pmp1\.on",),
)


# A room that heats itself, unless somebody overrides it.

_ROOM, _ENVELOPE, _RADIATOR = 6e6, 150.0, 5000.0  # J/K, W/K, W


def _self_heating(v: Symbols) -> Equations:
    from sympy import Max, Min

    own = Max(0.0, Min(1.0, 0.25 * (294.15 - v.reaTRoo_y)))
    heating = own + v.oveHea_activate * (v.oveHea_u - own)
    return Equations({"reaTRoo_y": (_RADIATOR * heating - _ENVELOPE * (v.reaTRoo_y - v.weaTDryBul)) / _ROOM})


_READ = temperature("reaTRoo_y", 292.43, "Room air temperature")

OVERRIDE = Delivery(
    model=PlantModel(
        name="wrapped",
        equations=_self_heating,
        states=(_READ,),
        inputs=(
            V("oveHea_u", "", 0.0, 1.0, description="Heater modulating signal"),
            V("oveHea_activate", "", description="Activation for Heater modulating signal"),
            temperature("weaTDryBul", 278.15),
        ),
        outputs=(_READ,),
        stop_time=365 * DAY,
    ),
    driven=sets("oveHea_u"),
    controlled=sets("reaTRoo_y"),
    disturbances=frozenset({"weaTDryBul"}),
    steady=lambda u: {"reaTRoo_y": u["weaTDryBul"] + _RADIATOR * u["oveHea_u"] / _ENVELOPE},
    ends={"oveHea_u": (0.0, 1.0)},
    plausible={"reaTRoo_y": COMFORT},
    constants=one(_ROOM / _ENVELOPE),
)


# A controller, delivered for itself.


def _pi(v: Symbols) -> Equations:
    from sympy import Max, Min

    error = v.TSet - v.TMea
    return Equations({"xI": error / 600.0}, {"yHea": Max(0.0, Min(1.0, 0.1 * (error + v.xI)))})


CONTROLLER = Delivery(
    model=PlantModel(
        name="RoomCtrl_PI",
        equations=_pi,
        states=(V("xI", "K", start=3.0),),
        inputs=(temperature("TSet", 294.15, "Set point"), temperature("TMea", 293.15, "Measured")),
        outputs=(V("yHea", "", 0.0, 1.0, description="Heating signal"),),
        stop_time=HOUR,
    ),
    is_controller=True,
    told=("looks like a controller", "TSet", "TMea", "yHea"),
)


# A filter, and something without any memory.

_FILTERED = V("sigOut", "", start=3.0)

FILTER = Delivery(
    model=PlantModel(
        name="PT1_Block",
        equations=lambda v: Equations({"sigOut": (v.sigIn - v.sigOut) / 0.05}),
        states=(_FILTERED,),
        inputs=(V("sigIn", "", start=3.0),),
        outputs=(_FILTERED,),
        step_size=0.01,
        stop_time=1.0,
    ),
    driven=sets("sigIn"),
    controlled=sets("sigOut"),
    steady=lambda u: {"sigOut": u["sigIn"]},
    ends={"sigIn": (0.0, 6.0)},
    constants=one(0.05),
)

MIXER = Delivery(
    model=PlantModel(
        name="ThreeWayMixer",
        equations=lambda v: Equations({}, {"TMix": v.xVlv * v.THot + (1 - v.xVlv) * v.TCold}),
        inputs=(
            V("xVlv", "", 0.0, 1.0, start=0.5),
            temperature("THot", 343.15),
            temperature("TCold", 283.15),
        ),
        outputs=(temperature("TMix", 0.0),),
        step_size=1.0,
        stop_time=100.0,
    ),
    driven=sets("xVlv", "xVlv,THot", "xVlv,TCold", "xVlv,THot,TCold"),
    controlled=sets("TMix"),
    may_disturb=frozenset({"THot", "TCold"}),
    steady=lambda u: {"TMix": u["xVlv"] * u["THot"] + (1 - u["xVlv"]) * u["TCold"]},
    ends={"xVlv": (0.0, 1.0), "THot": (323.15, 363.15), "TCold": (278.15, 293.15)},
    plausible={"TMix": (275.0, 365.0)},
    told=("no delay|no dynamics|static|at once|immediate",),
)


# A rod that stands upright.

_ROD, _FALLING = 0.02, 1.5  # kg.m2, N.m/rad
_ANGLE, _TURNING = V("phi_rad", "rad"), V("w_rads", "rad/s")


def _rod(v: Symbols) -> Equations:
    from sympy import sin

    torque = _FALLING * sin(v.phi_rad) - 0.01 * v.w_rads + v.MTor_Nm
    return Equations({"phi_rad": v.w_rads, "w_rads": torque / _ROD})


ROD = Delivery(
    model=PlantModel(
        name="InvertedRod",
        equations=_rod,
        states=(_ANGLE, _TURNING),
        inputs=(V("MTor_Nm", "N.m", -2.0, 2.0),),
        outputs=(_ANGLE, _TURNING),
        stop_time=10.0,
    ),
    driven=sets("MTor_Nm"),
    controlled=sets("phi_rad"),
    plausible={"phi_rad": (-1.0, 1.0)},  # what a torque of 2 N.m lifts: sin(phi) = 2 / 1.5
    constants=one(math.sqrt(_ROD / _FALLING)),
    told=("unstable",),
    is_unstable=True,
)


# What adds up: an axis that is told its speed, a buffer between two flows.

_AXIS_LAG = 0.08  # s
_PLACE, _PACE = V("xAx_m", "m", 0.0, 1.2, start=0.4), V("vAx_ms", "m/s")

AXIS = Delivery(
    model=PlantModel(
        name="LinearAxisX",
        equations=lambda v: Equations({"xAx_m": v.vAx_ms, "vAx_ms": (v.vCmd_ms - v.vAx_ms) / _AXIS_LAG}),
        states=(_PLACE, _PACE),
        inputs=(V("vCmd_ms", "m/s", -0.5, 0.5),),
        outputs=(_PLACE, _PACE),
        stop_time=5.0,
    ),
    driven=sets("vCmd_ms"),
    controlled=sets("xAx_m", "vAx_ms"),
    plausible={"xAx_m": (0.0, 1.2), "vAx_ms": (-0.5, 0.5)},
    constants=(_AXIS_LAG, 2 * _AXIS_LAG),
    told=("integrat",),
)

_BUFFER_LEVEL = V("LBuf_m", "m", 0.0, 4.0, start=2.0)

BUFFER = Delivery(
    model=PlantModel(
        name="BufferVessel",
        equations=lambda v: Equations({"LBuf_m": (v.qFil_m3s - v.qCons_m3s) / 5.0}),
        states=(_BUFFER_LEVEL,),
        inputs=(
            V("qCons_m3s", "m3/s", 0.0, start=0.02, description="Consumption of the process"),
            V("qFil_m3s", "m3/s", 0.0, 0.05, start=0.02, description="Filling pump"),
        ),
        outputs=(_BUFFER_LEVEL,),
        stop_time=HOUR,
    ),
    driven=sets("qFil_m3s"),
    controlled=sets("LBuf_m"),
    disturbances=frozenset({"qCons_m3s"}),
    plausible={"LBuf_m": (0.0, 4.0)},
    sampling=(1.0, 50.0),  # it is full after 5 min at least
    told=("integrat",),
)


# A room with a day of its own inside.

_LIGHT, _LIGHT_LOSS, _SWING = 8e6, 200.0, 6.0  # J/K, W/K, K


def _day(v: Symbols) -> Equations:
    from sympy import pi, sin

    outside = 280.0 + _SWING * sin(2 * pi * v.time / DAY)
    return Equations({"TRoom_K": (v.PHea_W - _LIGHT_LOSS * (v.TRoom_K - outside)) / _LIGHT})


_ROOM_OF_THE_DAY = temperature("TRoom_K", 291.15)

DAILY = Delivery(
    model=PlantModel(
        name="TestHouse_Winter",
        equations=_day,
        states=(_ROOM_OF_THE_DAY,),
        inputs=(V("PHea_W", "W", 0.0, 6000.0, start=2600.0),),
        outputs=(_ROOM_OF_THE_DAY,),
        stop_time=7 * DAY,
    ),
    driven=sets("PHea_W"),
    controlled=sets("TRoom_K"),
    steady=lambda u: {"TRoom_K": 280.0 + u["PHea_W"] / _LIGHT_LOSS},  # the mean of a day
    ends={"PHea_W": (0.0, 6000.0)},
    plausible={"TRoom_K": COMFORT},
    constants=one(_LIGHT / _LIGHT_LOSS),
    period=DAY,
    told=("repeats every 24 h|repeats every 1 d",),
)


# A heat exchanger behind a pump that stands still and a valve that is shut.

_SECONDARY, _FULL_FLOW, _HEAT_LOSS = 3e5, 2000.0, 500.0  # J/K, W/K, W/K
_SECONDARY_SIDE = temperature("TSec_K")


def _exchanger_at(u: Levels) -> float:
    flow = _FULL_FLOW * u["nPmp"] * u["yVal"]
    return (flow * u["TPri_K"] + _HEAT_LOSS * 293.15) / (flow + _HEAT_LOSS)


EXCHANGER = Delivery(
    model=PlantModel(
        name="HX_Substation",
        equations=lambda v: Equations(
            {
                "TSec_K": (
                    _FULL_FLOW * v.nPmp * v.yVal * (v.TPri_K - v.TSec_K) - _HEAT_LOSS * (v.TSec_K - 293.15)
                )
                / _SECONDARY
            }
        ),
        states=(_SECONDARY_SIDE,),
        inputs=(V("nPmp", "", 0.0, 1.0), V("yVal", "", 0.0, 1.0), temperature("TPri_K", 343.15)),
        outputs=(_SECONDARY_SIDE,),
        stop_time=HOUR,
    ),
    driven=sets("nPmp", "yVal", "nPmp,yVal"),
    controlled=sets("TSec_K"),
    may_disturb=frozenset({"TPri_K"}),
    steady=lambda u: {"TSec_K": _exchanger_at(u)},
    ends={"nPmp": (0.0, 1.0), "yVal": (0.0, 1.0)},
    plausible={"TSec_K": (293.15, 343.15)},
    levels={"nPmp": (0.05, 1.0), "yVal": (0.05, 1.0)},
    constants=(_SECONDARY / (_FULL_FLOW + _HEAT_LOSS), _SECONDARY / _HEAT_LOSS),
    told=("next to nothing|do too little|does nothing|--at",),
)


# A greenhouse: three actuators, the weather, one temperature; the stop time that tools write by themselves.

_GLASSHOUSE = 2e6  # J/K


def _losing(vent: Any) -> Any:
    return 400.0 + 1500.0 * vent  # W/K


def _gaining(heat: Any, shade: Any, sun: Any) -> Any:
    return 2e4 * heat + 30.0 * (1 - 0.7 * shade) * sun  # W


_GREEN = temperature("TAirGh", 283.15 + 10e3 / 700.0)

GREENHOUSE = Delivery(
    model=PlantModel(
        name="Greenhouse_Comp3",
        equations=lambda v: Equations(
            {
                "TAirGh": (_gaining(v.uHea, v.uShd, v.GSol_Wm2) - _losing(v.uVen) * (v.TAirGh - v.TOut))
                / _GLASSHOUSE
            }
        ),
        states=(_GREEN,),
        inputs=(
            V("uHea", "", 0.0, 1.0, start=0.2),
            V("uVen", "", 0.0, 1.0, start=0.2),
            V("uShd", "", 0.0, 1.0),
            temperature("TOut", 283.15),
            V("GSol_Wm2", "W/m2", 0.0, start=200.0),
        ),
        outputs=(_GREEN,),
        stop_time=1.0,
    ),
    driven=sets("uHea", "uVen", "uHea,uVen", "uHea,uShd", "uVen,uShd", "uHea,uVen,uShd"),
    controlled=sets("TAirGh"),
    disturbances=frozenset({"TOut", "GSol_Wm2"}),
    steady=lambda u: {
        "TAirGh": u["TOut"] + _gaining(u["uHea"], u["uShd"], u["GSol_Wm2"]) / _losing(u["uVen"])
    },
    ends={"uHea": (0.0, 1.0), "uVen": (0.0, 1.0), "uShd": (0.0, 1.0)},
    plausible={"TAirGh": (273.15, 323.15)},
    constants=one(_GLASSHOUSE / _losing(0.2)),
)


# A duct with a fan and a heater, and an input that is connected to nothing.

_FAN_LAG, _HEATER, _MASS_FLOW = 3.0, 4e4, 2.5 * 1006.0  # s, J/K, W/K
_DUCT = V("pDuc_kPa", "kPa", start=0.9 * 0.36)
_SUPPLY = V("TSup_degC", "degC", start=12.0 + 8000.0 / (0.6 * _MASS_FLOW))

DUCT = Delivery(
    model=PlantModel(
        name="SupplyAirUnit",
        equations=lambda v: Equations(
            {
                "pDuc_kPa": (0.9 * v.nFan_pu**2 - v.pDuc_kPa) / _FAN_LAG,
                "TSup_degC": (v.QHea_W - _MASS_FLOW * v.nFan_pu * (v.TSup_degC - v.TMixAir_degC)) / _HEATER,
            }
        ),
        states=(_DUCT, _SUPPLY),
        inputs=(
            V("spare1", ""),
            V("nFan_pu", "", 0.2, 1.0, start=0.6, description="Fan speed"),
            V("TMixAir_degC", "degC", start=12.0, description="Mixed air temperature"),
            V("QHea_W", "W", 0.0, 2e4, start=8000.0),
        ),
        outputs=(_DUCT, _SUPPLY),
        stop_time=600.0,
    ),
    driven=sets("nFan_pu,QHea_W"),
    controlled=sets("pDuc_kPa,TSup_degC"),
    disturbances=frozenset({"TMixAir_degC"}),
    steady=lambda u: {
        "pDuc_kPa": 0.9 * u["nFan_pu"] ** 2,
        "TSup_degC": u["TMixAir_degC"] + u["QHea_W"] / (_MASS_FLOW * u["nFan_pu"]),
    },
    ends={"nFan_pu": (0.2, 1.0), "QHea_W": (0.0, 2e4)},
    plausible={"TSup_degC": (0.0, 60.0), "pDuc_kPa": (0.0, 0.9)},
    constants=(_FAN_LAG, _HEATER / (0.6 * _MASS_FLOW)),
    told=("spare1",),
)


# A block whose surface answers at once, and one whose sensor picks up the heater.

_BLOCK, _BLOCK_LOSS = 4.5e4, 25.0  # J/K, W/K
_CORE = temperature("TCor_K", 295.0 + 800.0 / _BLOCK_LOSS)

SURFACE = Delivery(
    model=PlantModel(
        name="HotPlate",
        equations=lambda v: Equations(
            {"TCor_K": (v.PEl_W - _BLOCK_LOSS * (v.TCor_K - 295.0)) / _BLOCK},
            {"TSur_K": v.TCor_K + 0.01 * v.PEl_W},
        ),
        states=(_CORE,),
        inputs=(V("PEl_W", "W", 0.0, 2000.0, start=800.0),),
        outputs=(temperature("TSur_K", 0.0),),
        stop_time=2 * HOUR,
    ),
    driven=sets("PEl_W"),
    controlled=sets("TSur_K"),
    steady=lambda u: {"TSur_K": 295.0 + u["PEl_W"] * (1 / _BLOCK_LOSS + 0.01)},
    ends={"PEl_W": (0.0, 2000.0)},
    constants=one(_BLOCK / _BLOCK_LOSS),
)

PYROMETER = Delivery(
    model=PlantModel(
        name="InductionStage",
        equations=lambda v: Equations(
            {
                "TCor_K": (v.PInd_W - _BLOCK_LOSS * (v.TCor_K - 295.0)) / _BLOCK,
                "PSlow": (v.PInd_W - v.PSlow) / 0.5,
            },
            {"TPyr_K": v.TCor_K + 0.2 * (v.PInd_W - v.PSlow)},
        ),
        states=(_CORE, V("PSlow", "W", start=800.0)),
        inputs=(V("PInd_W", "W", 0.0, 2000.0, start=800.0),),
        outputs=(temperature("TPyr_K", 0.0, "Pyrometer, picks up the coil"),),
        stop_time=2 * HOUR,
    ),
    driven=sets("PInd_W"),
    controlled=sets("TPyr_K"),
    steady=lambda u: {"TPyr_K": 295.0 + u["PInd_W"] / _BLOCK_LOSS},
    ends={"PInd_W": (0.0, 2000.0)},
    constants=one(_BLOCK / _BLOCK_LOSS),
)


# A water turbine, whose power falls first when its gate opens.

_WATER, _SERVO = 1.5, 0.5  # s
_GATE, _FLOW = V("gAct", "", start=0.6), V("qTur", "", start=0.6)

TURBINE = Delivery(
    model=PlantModel(
        name="FrancisUnit2",
        equations=lambda v: Equations(
            {"gAct": (v.gov_gCmd - v.gAct) / _SERVO, "qTur": (1 - (v.qTur / v.gAct) ** 2) / _WATER},
            {"PMec_W": 20e6 * v.qTur**3 / v.gAct**2},
        ),
        states=(_GATE, _FLOW),
        inputs=(V("gov_gCmd", "", 0.1, 1.0, start=0.6, description="Gate command"),),
        outputs=(V("PMec_W", "W"),),
        stop_time=30.0,
    ),
    spelt={"gov_gCmd": "gov.gCmd"},
    driven=sets("gov.gCmd"),
    controlled=sets("PMec_W"),
    steady=lambda u: {"PMec_W": 20e6 * u["gov.gCmd"]},
    ends={"gov.gCmd": (0.1, 1.0)},
    constants=(_SERVO, _SERVO + 2 * _WATER * 0.6 / 2),
)


# A pipe, in twelve pieces, behind a heater and before a vessel.

_PIECES, _TRANSPORT, _VESSEL, _STREAM = 12, 60.0, 120.0, 836.0  # 1, s, s, W/K


def _pipe(v: Symbols) -> Equations:
    names = [*(f"T_{k}" for k in range(_PIECES)), "TDel_K"]
    lags = [_TRANSPORT / _PIECES] * _PIECES + [_VESSEL]
    before = [v.TInl_K + v.QHtr_W / _STREAM, *(v[name] for name in names)]
    return Equations(
        {name: (past - v[name]) / lag for name, past, lag in zip(names, before, lags, strict=False)}
    )


_DELIVERED = 288.15 + 15e3 / _STREAM

PIPE = Delivery(
    model=PlantModel(
        name="SupplyLine_DN50",
        equations=_pipe,
        states=(
            *(temperature(f"T_{k}", _DELIVERED) for k in range(_PIECES)),
            temperature("TDel_K", _DELIVERED),
        ),
        inputs=(
            V("QHtr_W", "W", 0.0, 3e4, start=15e3),
            temperature("TInl_K", 288.15, "Inlet water temperature"),
        ),
        outputs=(temperature("TDel_K", _DELIVERED),),
        stop_time=1800.0,
    ),
    fmi="3.0",
    driven=sets("QHtr_W"),
    controlled=sets("TDel_K"),
    disturbances=frozenset({"TInl_K"}),
    steady=lambda u: {"TDel_K": u["TInl_K"] + u["QHtr_W"] / _STREAM},
    ends={"QHtr_W": (0.0, 3e4)},
    constants=(_VESSEL, _VESSEL + _TRANSPORT),
)


# Compressed air, in bar and revolutions per minute.

_NETWORK, _STROKES, _LEAKING = 0.6, 4e-4, 0.03  # kg/bar, kg/s per rpm, kg/(s.bar)


def _compressed(u: Levels) -> float:
    drawn = _STROKES * u["nCmp_rpm"]
    return (drawn - u["mDem_kgs"]) / (drawn / 20.0 + _LEAKING)


_AIR = V("pNet_bar", "bar", start=8.0)

COMPRESSOR = Delivery(
    model=PlantModel(
        name="CompressedAirNet",
        equations=lambda v: Equations(
            {
                "pNet_bar": (
                    _STROKES * v.nCmp_rpm * (1 - v.pNet_bar / 20.0) - _LEAKING * v.pNet_bar - v.mDem_kgs
                )
                / _NETWORK
            }
        ),
        states=(_AIR,),
        inputs=(
            V("nCmp_rpm", "rpm", 500.0, 3000.0, start=1500.0),
            V("mDem_kgs", "kg/s", 0.0, start=0.12, description="Demand"),
        ),
        outputs=(_AIR,),
        stop_time=300.0,
    ),
    driven=sets("nCmp_rpm"),
    controlled=sets("pNet_bar"),
    disturbances=frozenset({"mDem_kgs"}),
    steady=lambda u: {"pNet_bar": _compressed(u)},
    ends={"nCmp_rpm": (500.0, 3000.0)},
    plausible={"pNet_bar": (0.0, 16.0)},
    constants=one(_NETWORK / (_STROKES * 1500.0 / 20.0 + _LEAKING)),
)


# A heat pump's room, where nobody has said how cold it is outside: 0 K.

HEAT_PUMP = Delivery(
    model=PlantModel(
        name="HP_Room",
        equations=lambda v: Equations(
            {"TLiv": (v.PNom_W * v.hpu_u_set - 200.0 * (v.TLiv - v.bus_TAmb)) / 5e6}
        ),
        states=(temperature("TLiv"),),
        inputs=(V("hpu_u_set", "", 0.0, 1.0, start=0.2), temperature("bus_TAmb", 0.0)),
        outputs=(temperature("TLiv"),),
        parameters=(Parameter("PNom_W", "W", start=5000.0),),
        stop_time=7 * DAY,
    ),
    spelt={"hpu_u_set": "hpu.u_set", "bus_TAmb": "bus.TAmb"},
    driven=sets("hpu.u_set"),
    controlled=sets("TLiv"),
    disturbances=frozenset({"bus.TAmb"}),
    steady=lambda u: {"TLiv": u["bus.TAmb"] + 25.0 * u["hpu.u_set"]},
    ends={"hpu.u_set": (0.0, 1.0)},
    plausible={"TLiv": COMFORT},
    levels={"bus.TAmb": (250.0, 320.0)},
    constants=one(5e6 / 200.0),
    told=(r"bus\.TAmb\W.{0,40}\b0 K",),
)


DELIVERIES: Mapping[str, Delivery] = {
    "zone in the weather": ZONE,
    "coil in degC": COIL,
    "tank and demand": TANK,
    "neutralisation": NEUTRALISATION,
    "chemostat": CHEMOSTAT,
    "fishery": FISHERY,
    "reactor and feed": REACTOR,
    "motor under load": MOTOR,
    "boiler": BOILER,
    "hydraulic cylinder": CYLINDER,
    "battery": BATTERY,
    "car on a slope": CAR,
    "pump switched off": PUMP,
    "override": OVERRIDE,
    "controller": CONTROLLER,
    "filter": FILTER,
    "static mixer": MIXER,
    "unstable rod": ROD,
    "axis": AXIS,
    "buffer": BUFFER,
    "day inside": DAILY,
    "dead at rest": EXCHANGER,
    "greenhouse": GREENHOUSE,
    "duct with a spare input": DUCT,
    "feedthrough": SURFACE,
    "spike": PYROMETER,
    "non-minimum phase": TURBINE,
    "dead time": PIPE,
    "bar and rpm": COMPRESSOR,
    "ambient at 0 K": HEAT_PUMP,
}
