"""Bodies of requests. Strict: no conversion, no NaN, no unknown field."""

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Ask = Literal["arm", "disarm", "manual", "auto", "hold", "stop", "reset"]
Identifier = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_.-]+$")]
Label = Annotated[str, Field(max_length=80)]


class _Body(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class Point(_Body):
    """A point in the frame that the client has at hand: vessel and image in px, stage in µm."""

    frame: Literal["vessel", "image", "stage"]
    x: float
    y: float


class AreaBody(_Body):
    """A critical area: its centre and the radius within which the task counts as arrived."""

    center: Point
    epsilon_um: Annotated[float, Field(gt=0)] = 500.0
    label: Label = ""


class HandBody(_Body):
    """How far the tip goes for the hand's motion."""

    scale: Literal["coarse", "fine"]


class OrderBody(_Body):
    """The order in which critical areas are visited: every id once."""

    order: Annotated[list[Identifier], Field(max_length=100)]


class ModeBody(_Body):
    """An ask for a mode; ``auto`` goes to a critical area."""

    ask: Ask
    area: Identifier | None = None


class LeaseBody(_Body):
    """Taking control; ``client`` is the name under which others see the holder.

    ``force`` takes it from whoever has it: the rig comes to rest first. For chiefs alone.
    """

    client: Label = "page"
    force: bool = False


class TrialBody(_Body):
    """A trial of a study."""

    participant: Identifier
    condition: Literal["with_autonomy", "without_autonomy"]
    operator_kind: Literal["human", "simulated"] = "human"
    notes: Annotated[str, Field(max_length=2000)] = ""


class TlxChoice(_Body):
    """One pair of scales, and which of the two contributed more to the workload."""

    left: Identifier
    right: Identifier
    chosen: Identifier


class TlxBody(_Body):
    """A questionnaire: a mark per scale, and the fifteen choices in the order in which they were asked.

    ``replace`` corrects answers that are there already; they are kept beside.
    """

    ratings: Annotated[dict[Identifier, int], Field(max_length=12)]
    choices: Annotated[list[TlxChoice], Field(max_length=30)]
    replace: bool = False


class RegistrationBody(_Body):
    """Where the vessel lies: found in the picture, or moved by hand from where it is taken to lie."""

    auto: bool = False
    dx_um: float = 0.0
    dy_um: float = 0.0
    turn_deg: float = 0.0

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if self.auto and (self.dx_um or self.dy_um or self.turn_deg):
            raise ValueError("auto finds the vessel by itself: leave out dx_um, dy_um and turn_deg")
        return self


class Heartbeat(_Body):
    """An operator's page is alive."""

    type: Literal["heartbeat"]


class AskMessage(ModeBody):
    """An ask for a mode over ``/ws/twin``."""

    type: Literal["ask"]


class TakeHand(_Body):
    """A page wants to be the rig's hand; ``frame`` are the axes of its positions."""

    type: Literal["take_hand"]
    client: Annotated[str, Field(min_length=1, max_length=64)] = "page"
    frame: Literal["stage", "webxr", "unity"] = "stage"


class GiveHand(_Body):
    """A page gives the hand's seat back."""

    type: Literal["give_hand"]


TwinMessage = Annotated[Heartbeat | AskMessage | TakeHand | GiveHand, Field(discriminator="type")]
"""What a client may send over ``/ws/twin``, beside the hand link's ``hand``."""
