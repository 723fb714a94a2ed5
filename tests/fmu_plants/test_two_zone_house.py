"""The house: its FMU against formulas written here, its energy, its control, its year and its resources."""

import json
import zipfile
from functools import cache
from io import StringIO

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from ddpc_cosim import FMUPlant
from fmu_plants import build_fmu
from fmu_plants.equations import resolve
from fmu_plants.two_zone_house import MODEL

HOUR, DAY = 3600.0, 86400.0
AREA = np.array([100.0, 80.0])  # m2
OPAQUE = np.array([156.0, 137.0])
POWER = np.array([1800.0, 1450.0])  # W
FLOOR_GROUND, SUPPLY_FLOOR = 0.25 * AREA, 5.5 * AREA  # W/K
AIR_ENVELOPE, AIR_INNER = 5.5 * OPAQUE, 7.7 * np.array([40.0, 32.0])
AIR_OUTDOOR = np.array([18.0, 10.0]) + 0.5 * 0.34 * 2.6 * AREA
ENVELOPE_OUTDOOR = 0.22 * OPAQUE + 5.0
CAPACITY = np.concatenate([20e3 * AREA, 130e3 * AREA, 80e3 * OPAQUE, [8e6]])  # J/K
STATES = ["reaTZon1_y", "reaTZon2_y", "reaTFlo1_y", "reaTFlo2_y", "TEnv1", "TEnv2", "TPar"]
OVERRIDES = [f"oveHeaPumZon{i}_u" for i in (1, 2)]


def regression(x):
    """Staffell et al. (2012), air source."""
    return 6.81 - 0.121 * x + 0.00063 * x**2


def larger(a, b):
    """The larger of two, smooth within 0.5 K of where they meet."""
    return (a + b + np.hypot(a - b, 0.5)) / 2


def heat_of(floor, outdoors, power):
    """The heat that fits the supply that it makes, a contraction, held beyond 15 and 60 K."""
    x = floor - outdoors
    for _ in range(60):
        x = floor - outdoors + power * regression(x) / SUPPLY_FLOOR
    return power * regression(-larger(-larger(x, 15.0), -60.0))


def flows(x, u, outdoors):
    """Heat into rooms from floors, of heat pumps, and lost through windows, walls and to the ground, W."""
    room, floor, envelope = x[0:2], x[2:4], x[4:6]
    excess = floor - room
    return {
        "floor": 8.92 * AREA * excess * (excess**2 + 0.01) ** 0.05,  # EN 1264-2, smooth at 0
        "heat pump": heat_of(floor, outdoors, u * POWER),
        "windows": AIR_OUTDOOR * (room - outdoors),
        "walls": ENVELOPE_OUTDOOR * (envelope - outdoors),
        "ground": FLOOR_GROUND * (floor - 283.15),
    }


def house(x, u, outdoors, sun, convective, radiant):
    """Time derivatives of all temperatures, K/s; what is per zone has shape (2,)."""
    room, envelope, inner = x[0:2], x[4:6], x[6]
    flow = flows(x, u, outdoors)
    into_envelope, into_inner = AIR_ENVELOPE * (room - envelope), AIR_INNER * (room - inner)
    into = [
        flow["floor"] - into_envelope - into_inner - flow["windows"] + 0.1 * sun + convective,
        flow["heat pump"] - flow["floor"] - flow["ground"] + 0.6 * sun + 0.4 * radiant,
        into_envelope - flow["walls"] + 0.3 * sun + 0.6 * radiant,
        [into_inner.sum()],
    ]
    return np.concatenate(into) / CAPACITY


@pytest.fixture(scope="module")
def fmu():
    return build_fmu(MODEL)


@cache
def tables_of(fmu):
    """The tables of the FMU: by file its columns, by head; each of shape (8761,)."""
    tables = {}
    with zipfile.ZipFile(fmu) as archive:
        for name in archive.namelist():
            if name.endswith(".csv"):
                text = archive.read(name).decode()
                rows = np.loadtxt(StringIO(text), delimiter=",", skiprows=1, ndmin=2)
                tables[name.removeprefix("resources/")] = dict(
                    zip(text.split("\n", 1)[0].split(","), rows.T, strict=True)
                )
    return tables


def sun_on_rooms(weather):
    south, west, north, east = (weather[f"HVer{wall}"] for wall in ("Sou", "Wes", "Nor", "Eas"))
    return 0.4 * np.column_stack([14 * south + 4 * west, 4 * north + 6 * east])


def with_weather(fmu, folder, celsius):
    """The same house where it is always as warm, without sun, and without people and devices."""
    path = folder / "constant.fmu"
    with zipfile.ZipFile(fmu) as given, zipfile.ZipFile(path, "w") as changed:
        for entry in given.namelist():
            content = given.read(entry)
            if entry in ("resources/weather.csv", "resources/internalGains.csv"):
                head = content.decode().split("\n", 1)[0]
                first = celsius + 273.15 if entry.endswith("weather.csv") else 0.0
                row = ",".join([str(first)] + ["0"] * (head.count(",") - 1))
                content = f"{head}\n0,{row}\n31536000,{row}\n".encode()
            changed.writestr(entry, content)
    return path


def overridden(path, outputs):
    switches = {f"oveHeaPumZon{i}_activate": 1.0 for i in (1, 2)}
    return FMUPlant(path, inputs=OVERRIDES, outputs=outputs, start=switches)


def steady(u, celsius):
    """Temperatures at rest without sun and gains, K, shape (7,)."""
    nothing = np.zeros(2)
    return fsolve(
        lambda x: house(x, u, celsius + 273.15, nothing, nothing, nothing) * CAPACITY,
        np.array([294.0, 294.0, 298.0, 298.0, 290.0, 290.0, 294.0]),
        xtol=1e-12,
    )


def test_it_rests_where_the_formula_does_and_loses_what_it_gets(fmu, tmp_path):
    u = np.array([0.7, 0.75])
    with overridden(with_weather(fmu, tmp_path, -10.0), STATES[:4]) as plant:
        plant.reset()
        for _ in range(60):
            reached = plant.step(u, DAY)
    x = steady(u, -10.0)
    assert reached == pytest.approx(x[:4], abs=1e-3)
    flow = {name: value.sum() for name, value in flows(x, u, 263.15).items()}
    assert flow["heat pump"] == pytest.approx(flow["windows"] + flow["walls"] + flow["ground"], rel=1e-9)


def test_it_needs_six_kilowatts_at_minus_ten():
    u = fsolve(lambda u: steady(u, -10.0)[:2] - 294.15, [0.7, 0.7])
    x = steady(u, -10.0)
    assert (u < 1.0).all()
    assert flows(x, u, 263.15)["heat pump"].sum() == pytest.approx(6.2e3, rel=0.05)
    assert x[2:4].max() < 273.15 + 29.0


def test_no_energy_appears_or_gets_lost():
    """What all parts store is what heat pumps, sun and people give, less what is lost: identically."""
    import sympy

    symbolic = resolve(MODEL)
    values = {sympy.Symbol(p.name, real=True): p.start for p in MODEL.parameters}
    rng = np.random.default_rng(3)
    names = [v.name for v in (*MODEL.states, *MODEL.columns, *MODEL.actuators)]
    symbols = [sympy.Symbol(name, real=True) for name in names]
    derivatives = sympy.lambdify(symbols, [e.xreplace(values) for e in symbolic.derivatives.values()])
    for _ in range(50):
        at = dict.fromkeys(names, 0.0)
        x = 290.0 + rng.uniform(-10, 15, 7)
        u, outdoors = rng.uniform(0, 1, 2), 280.0 + rng.uniform(-20, 20)
        at |= dict(zip(STATES, x, strict=True)) | {"TDryBul": outdoors}
        at |= {f"HeaPumZon{i}": u[i - 1] for i in (1, 2)}
        at |= {name: rng.uniform(0, 800) for name in names if name.startswith(("HVer", "InternalGains"))}
        sun = 0.4 * (14 * at["HVerSou"] + 4 * at["HVerWes"] + 4 * at["HVerNor"] + 6 * at["HVerEas"])
        gains = sum(value for name, value in at.items() if name.startswith("InternalGains"))
        flow = {name: value.sum() for name, value in flows(x, u, outdoors).items()}
        stored = CAPACITY @ derivatives(*at.values())
        lost = flow["windows"] + flow["walls"] + flow["ground"]
        assert stored == pytest.approx(flow["heat pump"] + sun + gains - lost, abs=1e-6)


@pytest.mark.parametrize("celsius", [-15.0, 0.0, 7.0, 20.0])
def test_the_heat_pump_has_the_published_coefficient(fmu, tmp_path, celsius):
    """At 20 degC the supply is less than 15 K warmer: the coefficient is that of 15 K."""
    outputs = ["reaTSup1_y", "reaPHeaPum_y", "reaQHeaPumCon_y"]
    with overridden(with_weather(fmu, tmp_path, celsius), outputs) as plant:
        plant.reset()
        for u in (0.2, 0.6, 1.0):
            supply, power, heat = plant.step(np.array([u, 0.0]), HOUR)
            assert power == pytest.approx(u * 1800.0)
            x = np.clip(supply - celsius - 273.15, 15.0, 60.0)
            assert heat / power == pytest.approx(regression(x), rel=5e-3)


class Control:
    """The rules as they are said: heating curve, room thermostat, schedule with optimum start."""

    def __init__(self):
        self.heating, self.preheating = [False, False], [False, False]

    def commands(self, x, outdoors, until_home, until_away):
        return np.array([self._zone(i, x[i], x[2 + i], outdoors, until_home, until_away) for i in (0, 1)])

    def _zone(self, i, room, floor, outdoors, until_home, until_away):
        comfort = 294.15 + 0.2
        if until_away > 0:
            self.preheating[i] = False
        elif until_home <= 3.5 * HOUR + 3.55 * HOUR * max(comfort - room, 0.0):
            self.preheating[i] = True
        wanted = comfort if until_away > HOUR or self.preheating[i] else 273.15 + 19.5
        if room < wanted - 0.3:
            self.heating[i] = True
        elif room > wanted + 0.3:
            self.heating[i] = False
        curve = 273.15 + 21.5 + 0.125 * (294.15 - outdoors) + 2.35 * (wanted - room)
        return min(max(0.28 * (curve - floor), 0.0), 1.0) if self.heating[i] else 0.0


def test_three_days_under_its_own_control_are_those_of_another_solver(fmu):
    start, duration, instant = 25 * DAY, 3 * DAY, 300.0
    tables = tables_of(fmu)
    weather, gains, schedule = (tables[f"{name}.csv"] for name in ("weather", "internalGains", "schedule"))
    sun = sun_on_rooms(weather)
    control = Control()
    x = np.array([variable.start for variable in MODEL.states])
    expected = [x]
    for k in range(int(duration / instant)):
        t = start + k * instant
        hour = int(t // HOUR)

        def outside(t):
            return np.array([np.interp(t, weather["time"], c) for c in (weather["TDryBul"], *sun.T)])

        u = control.commands(x, outside(t)[0], schedule["UntilHome"][hour], schedule["UntilAway"][hour])
        of_people = [[gains[f"InternalGains{k}[{i}]"][hour] for i in (1, 2)] for k in ("Con", "Rad")]

        def slope(t, x, u=u, of_people=of_people):
            outdoors, *suns = outside(t)
            return house(x, u, outdoors, np.array(suns), *np.array(of_people))

        x = solve_ivp(slope, (t, t + instant), x, rtol=1e-7, atol=1e-6).y[:, -1]
        expected.append(x)
    with FMUPlant(fmu, inputs=[], outputs=STATES[:4]) as plant:
        rows = [plant.reset(t0=start)]
        rows += [plant.step(np.zeros(0), 2700.0).copy() for _ in range(int(duration / 2700.0))]
    assert np.array(rows) == pytest.approx(np.array(expected)[::9, :4], abs=1e-4)


@pytest.fixture(scope="module")
def year(fmu):
    """What is measured every 15 min of the year that follows a year, by name; the time from its start, s."""
    names = [variable.name for variable in MODEL.outputs]
    with FMUPlant(fmu, inputs=[], outputs=names) as plant:
        rows = [plant.reset(t0=-14 * DAY)]
        rows += [plant.step(np.zeros(0), 900.0).copy() for _ in range((365 + 14) * 96)]
    return dict(zip(names, np.array(rows)[14 * 96 :].T, strict=True)) | {
        "time": 900.0 * np.arange(365 * 96 + 1)
    }


def test_its_year_is_plausible(year):
    heating = (year["time"] < 105 * DAY) | (year["time"] > 290 * DAY)
    for i in (1, 2):
        celsius = year[f"reaTZon{i}_y"] - 273.15
        assert 19.0 < celsius.min() < celsius.max() < 32.0
        assert celsius[heating].max() < 25.0
        assert year[f"reaTFlo{i}_y"].max() < 273.15 + 32.0
        assert year[f"reaTFlo{i}_y"][heating].max() < 273.15 + 29.0  # EN 1264: where people stay
        assert year[f"reaTSup{i}_y"].max() < 273.15 + 36.0
    power, heat = (
        np.trapezoid(year[name], year["time"]) / 3.6e6 for name in ("reaPHeaPum_y", "reaQHeaPumCon_y")
    )
    assert 0.0 <= year["reaPHeaPum_y"].min() < year["reaPHeaPum_y"].max() <= 3250.0 + 1e-9
    assert 12.0 < power / 180.0 < 25.0  # kWh/m2
    assert 3.5 < heat / power < 4.5
    summer = year["reaPHeaPum_y"][(year["time"] > 160 * DAY) & (year["time"] < 220 * DAY)]
    assert summer.mean() < 50.0


def test_its_own_control_keeps_the_comfort_of_the_scenarios(fmu, year):
    """At most 1 K.h in 14 days, as it was tuned for in other years."""
    setpoints = tables_of(fmu)["setpoints.csv"]
    for day in scenario_days(fmu).values():
        window = (year["time"] >= (day - 7) * DAY) & (year["time"] <= (day + 7) * DAY)
        hour = (year["time"][window] // HOUR).astype(int)
        for i in (1, 2):
            room = year[f"reaTZon{i}_y"][window]
            below = np.maximum(setpoints[f"LowerSetp[{i}]"][hour] - room, 0.0)
            above = np.maximum(room - setpoints[f"UpperSetp[{i}]"][hour], 0.0)
            assert np.trapezoid(below + above, dx=900.0) / HOUR < 1.0


def json_of(fmu, name):
    with zipfile.ZipFile(fmu) as archive:
        return json.loads(archive.read(f"resources/{name}"))


def scenario_days(fmu):
    return json_of(fmu, "days.json")


def test_its_resources_are_those_of_boptest(fmu):
    assert json_of(fmu, "config.json") == {
        "name": "two_zone_house",
        "area": 180.0,
        "start_time": (scenario_days(fmu)["peak_heat_day"] - 7) * DAY,
        "warmup_period": 7 * DAY,
        "step": 900.0,
    }
    outputs = {variable.name for variable in MODEL.outputs}
    kpis = json_of(fmu, "kpis.json")
    assert {name for names in kpis.values() for name in names} <= outputs
    assert {f"OperativeZoneTemperature[{i}]" for i in (1, 2)} | {"ElectricPower"} == set(kpis)
    tables = tables_of(fmu)
    for name, columns in tables.items():
        assert (columns["time"][0], columns["time"][-1]) == (0.0, 365 * DAY), name
    heads = {
        "occupancy.csv": ["Occupancy"],
        "internalGains.csv": ["InternalGainsCon", "InternalGainsRad"],
        "setpoints.csv": ["LowerSetp", "UpperSetp"],
    }
    for name, zoned in heads.items():
        assert set(tables[name]) == {"time"} | {f"{head}[{i}]" for head in zoned for i in (1, 2)}
    assert {"TDryBul", "HGloHor", "HDirNor", "HDifHor"} < set(tables["weather.csv"])


def test_people_are_somewhere_when_comfort_is_wanted_and_nowhere_else(fmu):
    tables = tables_of(fmu)
    persons = tables["occupancy.csv"]["Occupancy[1]"] + tables["occupancy.csv"]["Occupancy[2]"]
    hour = np.arange(8760)
    away = (hour // 24 % 7 < 5) & (hour % 24 >= 7) & (hour % 24 < 20)
    assert (persons[:-1] == np.where(away, 0.0, 4.0)).all()
    for i in (1, 2):
        lower, upper = (tables["setpoints.csv"][f"{edge}Setp[{i}]"][:-1] for edge in ("Lower", "Upper"))
        assert lower == pytest.approx(np.where(away, 288.15, 294.15))
        assert upper == pytest.approx(np.where(away, 303.15, 297.15))
    home, left = (tables["schedule.csv"][name][:-1] for name in ("UntilHome", "UntilAway"))
    assert ((home == 0) == ~away).all()
    assert ((left == 0) == away).all()
    assert home.max() == 13 * HOUR  # a weekday from 7 to 20
    assert left.max() == (4 + 48 + 7) * HOUR  # Friday at 20 to Monday at 7


def test_tariffs_and_emissions_are_those_of_boptest(fmu):
    prices = tables_of(fmu)["prices.csv"]
    assert set(prices["PriceElectricPowerConstant"]) == {0.2535}
    hour = np.arange(8761) % 24
    day = (hour >= 7) & (hour < 22)
    assert prices["PriceElectricPowerDynamic"] == pytest.approx(np.where(day, 0.2666, 0.2383))
    market = prices["PriceElectricPowerHighlyDynamic"][:-1] - 0.2
    assert market.mean() == pytest.approx(0.097, abs=0.01)  # Belgian day-ahead market, 2023
    by_hour = market.reshape(365, 24).mean(axis=0)
    assert by_hour[2:5].max() < by_hour.mean() < by_hour[18:21].min()
    assert set(tables_of(fmu)["emissions.csv"]["EmissionsElectricPower"]) == {0.167}


def test_the_peak_day_needs_most_heat_and_the_typical_one_the_median(fmu):
    """Each day's load if it lasted for ever: 21 degC against what is outside, less sun and gains."""
    tables = tables_of(fmu)
    weather, gains = tables["weather.csv"], tables["internalGains.csv"]
    conductance = (AIR_OUTDOOR + AIR_ENVELOPE * ENVELOPE_OUTDOOR / (AIR_ENVELOPE + ENVELOPE_OUTDOOR)).sum()
    given = sun_on_rooms(weather).sum(axis=1) + sum(v for k, v in gains.items() if k != "time")
    load = conductance * (294.15 - weather["TDryBul"]) + FLOOR_GROUND.sum() * 11.0 - given
    daily = load[:-1].reshape(365, 24).mean(axis=1)
    days = scenario_days(fmu)
    inside = daily[14:358]
    assert daily[days["peak_heat_day"]] == inside.max()
    heating = np.sort(inside[inside > 0])
    assert daily[days["typical_heat_day"]] == heating[(len(heating) - 1) // 2]
