"""The critical areas that were marked: where autonomy hands over."""

from collections.abc import Callable, Sequence

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.records import CriticalArea
from mrnav_server.core.vessel import VesselMap

_EPSILON_RANGE_UM = (50.0, 3000.0)
_MOST = 100


class CriticalAreas:
    """Areas in the order in which they shall be visited: as they were marked, until that is changed.

    Args:
        vessel: Areas must lie where the robot fits.
        on_change: Called after every change.
    """

    def __init__(self, vessel: VesselMap, on_change: Callable[[], None] = lambda: None) -> None:
        self._vessel = vessel
        self._on_change = on_change
        self._areas: dict[str, CriticalArea] = {}
        self._visited: set[str] = set()
        self._made = 0

    def list(self) -> list[CriticalArea]:
        """Return all areas, in the order of their visits."""
        return list(self._areas.values())

    @property
    def visited(self) -> frozenset[str]:
        """Ids of the areas at which autonomy has arrived."""
        return frozenset(self._visited)

    def visit(self, area_id: str) -> None:
        """Note that autonomy has arrived at an area; one that was removed meanwhile is passed over."""
        if area_id in self._areas and area_id not in self._visited:
            self._visited.add(area_id)
            self._on_change()

    def following(self, area_id: str) -> CriticalArea | None:
        """Return where autonomy goes after an area: the next one in order that was not visited.

        After the last one it goes on with those that were left out before; None if all were visited.
        """
        ids = list(self._areas)
        at = ids.index(area_id) + 1 if area_id in ids else 0
        left = (other for other in ids[at:] + ids[:at] if other not in self._visited and other != area_id)
        return next((self._areas[other] for other in left), None)

    def tell(self) -> None:
        """Tell everybody the areas again: another one has become the active one."""
        self._on_change()

    def reorder(self, area_ids: Sequence[str]) -> None:
        """Change the order of the visits, and begin them anew: no area counts as visited.

        Raises:
            RefusedError: If these are not all ids, each once.
        """
        if sorted(area_ids) != sorted(self._areas):
            known = ", ".join(self._areas) or "none is marked"
            raise RefusedError("bad_order", f"name every critical area once ({known})")
        self._areas = {area_id: self._areas[area_id] for area_id in area_ids}
        self._visited.clear()
        self._on_change()

    def get(self, area_id: str) -> CriticalArea:
        """Return one area.

        Raises:
            RefusedError: If there is none with this id.
        """
        if area_id not in self._areas:
            known = ", ".join(self._areas) or "none is marked"
            raise RefusedError("no_such_area", f"there is no critical area {area_id!r} ({known})")
        return self._areas[area_id]

    def add(self, center: VesselPoint, epsilon_um: float, label: str) -> CriticalArea:
        """Mark an area and return it with its new id.

        Raises:
            RefusedError: If it lies where the robot cannot go, or its radius is out of range.
        """
        self._check(center, epsilon_um)
        if len(self._areas) >= _MOST:
            raise RefusedError("too_many_areas", f"{_MOST} areas are marked: remove some first")
        self._made += 1
        return self._store(CriticalArea(f"area-{self._made}", center, epsilon_um, label))

    def replace(self, area_id: str, center: VesselPoint, epsilon_um: float, label: str) -> CriticalArea:
        """Change an area and return it.

        Raises:
            RefusedError: If it does not exist, or the new values are refused.
        """
        self.get(area_id)
        self._check(center, epsilon_um)
        return self._store(CriticalArea(area_id, center, epsilon_um, label))

    def remove(self, area_id: str) -> None:
        """Forget an area.

        Raises:
            RefusedError: If it does not exist.
        """
        self.get(area_id)
        del self._areas[area_id]
        self._visited.discard(area_id)
        self._on_change()

    def _store(self, area: CriticalArea) -> CriticalArea:
        self._areas[area.id] = area
        self._visited.discard(area.id)
        self._on_change()
        return area

    def _check(self, center: VesselPoint, epsilon_um: float) -> None:
        low, high = _EPSILON_RANGE_UM
        if not low <= epsilon_um <= high:
            raise RefusedError("bad_epsilon", f"epsilon_um must lie between {low:.0f} and {high:.0f}")
        size = self._vessel.size_px
        if not (0 <= center.x_px < size and 0 <= center.y_px < size):
            raise RefusedError("outside", f"the center lies outside the vessel model (0..{size} px)")
        wall_um = self._vessel.wall_distance_px(center.x_px, center.y_px) * self._vessel.um_per_px
        if wall_um < 0:
            raise RefusedError("in_wall", f"the center lies {-wall_um:.0f} µm inside the wall")
        if not self._vessel.is_free(center.x_px, center.y_px):
            radius_um = self._vessel.robot_radius_px * self._vessel.um_per_px
            if wall_um <= radius_um:
                raise RefusedError(
                    "too_close",
                    f"the wall is {wall_um:.0f} µm away and the robot's radius is {radius_um:.0f} µm: "
                    f"move the center {radius_um - wall_um:.0f} µm further in",
                )
            raise RefusedError("unreachable", "the robot cannot reach this part of the vessel")
