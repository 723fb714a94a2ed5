"""The order in which coupled parts are stepped and evaluated, and their algebraic loops."""

from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import NamedTuple, TypeVar

from ddpc_cosim.coupling.wiring import PartInterface, Wiring

Node = TypeVar("Node", bound=Hashable)


class Evaluation(NamedTuple):
    """Parts whose outputs are to be computed together: one, or all those in an algebraic loop.

    Parameters
    ----------
    parts : tuple of str
        Their names.
    loop : tuple of int
        The values that follow from each other in a circle; empty for one part.
    """

    parts: tuple[str, ...]
    loop: tuple[int, ...] = ()


class Graph:
    """What depends on what in a coupled plant.

    Parameters
    ----------
    parts : mapping of str to PartInterface
        The parts by name.
    wiring : Wiring
        Their connections.

    Attributes
    ----------
    order : tuple of str
        The parts as they are stepped one after the other: those that are sampled, and then each after those
        that it follows, and within a circle of parts those first on whose outputs others depend without
        delay.
    loops : tuple of tuple of str
        The algebraic loops: inputs and outputs that follow from each other without delay.
    """

    def __init__(self, parts: Mapping[str, PartInterface], wiring: Wiring) -> None:
        self._wiring = wiring
        self._owner = [part for part, span in wiring.slices.items() for _ in range(span.start, span.stop)]
        self._first_output = len(wiring.values) - len(self._owner)
        needs = self._needs(parts)
        # The values that each output depends on without delay.
        self._direct = {place: {value for value, _ in links} for place, links in needs.items() if links}
        self.order = self._part_order(parts)
        self._components = components(range(len(wiring.values)), self._users(self._direct))
        self.loops = tuple(
            self._loop_texts(component, needs) for component in self._components if self._is_loop(component)
        )

    def evaluations(self, changed: Iterable[int]) -> list[Evaluation]:
        """Return what has to be computed, in this order, after some values have changed."""
        depth = dict.fromkeys(changed, 0)
        steps: dict[tuple[int, tuple[str, ...]], list[int]] = {}
        for component in self._components:
            before = {value for place in component for value in self._direct.get(place, ())}
            known = [depth[value] for value in before if value in depth]
            if not known or not any(place in self._direct for place in component):
                continue
            level = 1 + max(known)
            depth.update(dict.fromkeys(component, level))
            parts = tuple(dict.fromkeys(self.part_of(place) for place in component))
            steps.setdefault((level, parts), []).extend(component if self._is_loop(component) else ())
        in_order = sorted(steps.items(), key=lambda step: step[0][0])
        return [Evaluation(parts, tuple(loop)) for (_, parts), loop in in_order]

    def reached(self, changed: Iterable[int]) -> set[int]:
        """Return the outputs that depend on some values without delay, directly or through others."""
        reached, users = set[int](), self._users(self._direct)
        waiting = list(changed)
        while waiting:
            for place in users.get(waiting.pop(), ()):
                if place not in reached:
                    reached.add(place)
                    waiting.append(place)
        return reached

    def dependencies(self) -> dict[str, frozenset[str]]:
        """Return for each output of the system the inputs of it that it depends on without delay."""
        wiring = self._wiring
        reached = {v.name: {place, *self.reached([place])} for place, v in enumerate(wiring.inputs)}
        return {
            output.name: frozenset(name for name, places in reached.items() if source in places)
            for output, source in zip(wiring.outputs, wiring.output_map.sources.tolist(), strict=True)
        }

    def directly_before(self, places: Iterable[int]) -> set[str]:
        """Return the parts whose outputs some values depend on without delay, with no other in between."""
        values = {value for place in places for value in self._direct.get(place, ())}
        return {self.part_of(value) for value in values if value >= self._first_output}

    @property
    def outputs(self) -> range:
        """The values that are outputs of parts."""
        return range(self._first_output, len(self._wiring.values))

    def part_of(self, place: int) -> str:
        """Return the part whose output a value is."""
        return self._owner[place - self._first_output]

    def _needs(self, parts: Mapping[str, PartInterface]) -> dict[int, list[tuple[int, str]]]:
        """Return for each output the values it depends on without delay, each with the input between."""
        wiring = self._wiring
        needs: dict[int, list[tuple[int, str]]] = {}
        for name, part in parts.items():
            sources = wiring.input_maps[name].sources.tolist()
            value_of = {v.name: source for v, source in zip(part.inputs, sources, strict=True)}
            dependencies = part.dependencies
            for place, output in enumerate(part.outputs, wiring.slices[name].start):
                on = dependencies.get(output.name, frozenset())
                needs[place] = [
                    (value, f"{name}.{known}") for known, value in value_of.items() if known in on
                ]
        return needs

    @staticmethod
    def _users(needs: Mapping[int, Iterable[int]]) -> dict[int, list[int]]:
        users: dict[int, list[int]] = {}
        for place, values in needs.items():
            for value in values:
                users.setdefault(value, []).append(place)
        return users

    def _is_loop(self, component: Sequence[int]) -> bool:
        return len(component) > 1 or component[0] in self._direct.get(component[0], ())

    def _loop_texts(
        self, component: Sequence[int], needs: Mapping[int, list[tuple[int, str]]]
    ) -> tuple[str, ...]:
        """Return the variables of a loop on the way around it."""
        members, texts = set(component), dict[str, None]()
        for place in component:
            texts.update((through, None) for value, through in needs[place] if value in members)
            texts[self._wiring.values[place]] = None
        return tuple(texts)

    def _part_order(self, parts: Mapping[str, PartInterface]) -> tuple[str, ...]:
        follows: dict[str, set[str]] = {name: set() for name in parts}  # by any connection
        awaits: dict[str, set[str]] = {name: set() for name in parts}  # without delay
        for name in parts:
            for value in self._wiring.input_maps[name].sources.tolist():
                if value >= self._first_output:
                    follows[self.part_of(value)].add(name)
        for place, values in self._direct.items():
            for value in values:
                if value >= self._first_output:
                    awaits[self.part_of(value)].add(self.part_of(place))
        order = [
            name
            for circle in components(parts, follows)
            for group in components(circle, awaits)
            for name in group
        ]
        # Those that are sampled first: the others have gone ahead when they are stepped.
        return tuple(sorted(order, key=lambda name: not parts[name].is_sampled))


def components(nodes: Iterable[Node], successors: Mapping[Node, Iterable[Node]]) -> list[list[Node]]:
    """Return the strongly connected components of a graph, each before those that follow from it.

    Nodes that do not follow from each other keep their order (R. Tarjan, SIAM J. Computing 1 (1972) 146-160).
    """
    given = {node: i for i, node in enumerate(nodes)}
    index: dict[Node, int] = {}
    low: dict[Node, int] = {}
    path: dict[Node, None] = {}
    strongly_connected: list[list[Node]] = []
    for root in reversed(given):
        if root in index:
            continue
        work = [(root, iter(_within(given, successors.get(root, ()))))]
        index[root] = low[root] = len(index)
        path[root] = None
        while work:
            node, remaining = work[-1]
            for other in remaining:
                if other not in index:
                    index[other] = low[other] = len(index)
                    path[other] = None
                    work.append((other, iter(_within(given, successors.get(other, ())))))
                    break
                if other in path:
                    low[node] = min(low[node], index[other])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == index[node]:
                    component = [node]
                    while (other := path.popitem()[0]) != node:
                        component.append(other)
                    strongly_connected.append(sorted(component, key=given.__getitem__))
    return strongly_connected[::-1]


def _within(given: Mapping[Node, int], nodes: Iterable[Node]) -> list[Node]:
    """Return the given nodes among these, the last one first: components are found from the end."""
    return sorted((node for node in nodes if node in given), key=given.__getitem__, reverse=True)
