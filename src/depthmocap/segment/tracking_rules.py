"""Numbers by which people are followed: what belongs to one centre, who is a person, whose track ends."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class ClusteringRules:
    """Which votes are for one centre.

    Attributes:
        reach_m: votes within this distance of a centre are for it, which is known to some 10 cm, from limbs to 30 cm.
        new_reach_m: new centres are looked for with this reach: two who touch stand about so far apart.
        places: so many places are tried for a new centre.
        new_centres: so many new centres are looked for in one set.
        new_m2: a new centre needs this much surface: a head and shoulders at any distance.
        apart_m: it must be this far from all others; nearer votes belong to the other person's limbs.
        limb_m2: votes with less surface than this, within ``limb_m`` of a centre, are for limbs of that person.
        limb_m: see ``limb_m2``.
        valley_share: two heaps of votes are one if they are nowhere between their middles lower than this share of the
            lower middle.
        valley_m: heights of heaps are counted this far on both sides of each place.
        seen_m2: a track with less surface than this is not seen.
    """

    reach_m: float = 0.55
    new_reach_m: float = 0.3
    places: int = 100
    new_centres: int = 40
    new_m2: float = 0.05
    apart_m: float = 0.3
    limb_m2: float = 0.1
    limb_m: float = 0.9
    valley_share: float = 0.6
    valley_m: float = 0.08
    seen_m2: float = 0.01


@dataclasses.dataclass(frozen=True)
class MotionRules:
    """How a centre moves.

    Attributes:
        position_gain, velocity_gain: shares of the residual by which an update corrects position and velocity.
        predict_s: motion is predicted for no longer than this: an unseen person may have stopped.
        fastest_mps: nobody runs faster indoors.
    """

    position_gain: float = 0.6
    velocity_gain: float = 0.2
    predict_s: float = 0.3
    fastest_mps: float = 4.0


@dataclasses.dataclass(frozen=True)
class PersonRules:
    """When a track is certain to be a person. Certainty is the network's probability, averaged over the samples.

    Attributes:
        sets_needed: it was seen in so many sets,
        certain_s: over at least this time,
        certainty_m2, certainties: with so much certainty for so much surface, linear between: furniture that is
            taken for people mostly shows little.
        at_once_m2, at_once_certainty: one set is enough for a body of which so much is seen, so certainly.
        averaged_s: time over which certainty is averaged.
        moved_m, moved_certainty: of what has moved so far less certainty will do, because furniture stays where it is,
        before_share, before_certainty: and of what is mostly, by its surface, where the scene was seen empty,
        moved_before_certainty: and less still of what is both.
        beside_m, beside_s, beside_m2: what appears this near to somebody may be a limb that votes for itself: it needs
            this time and this surface to be another person.
        recognise_s: while others are away, a new track waits for its stature before it gets a number, at most so long,
        hidden_nearby_s: and so long where somebody was hidden nearby whose stature is known.
    """

    sets_needed: int = 3
    certain_s: float = 0.1
    certainty_m2: tuple[float, float] = (0.05, 0.3)
    certainties: tuple[float, float] = (0.9, 0.6)
    at_once_m2: float = 0.5
    at_once_certainty: float = 0.8
    averaged_s: float = 0.2
    moved_m: float = 0.25
    moved_certainty: float = 0.4
    before_share: float = 0.7
    before_certainty: float = 0.35
    moved_before_certainty: float = 0.12
    beside_m: float = 1.3
    beside_s: float = 0.6
    beside_m2: float = 0.3
    recognise_s: float = 1.9
    hidden_nearby_s: float = 0.7


@dataclasses.dataclass(frozen=True)
class EndRules:
    """When a track ends.

    Attributes:
        gone_s: it was not seen for this time,
        unborn_s: or, if it is no person yet, for this time.
        unsure_m2, unsure_certainty: it shows less than this with less certainty than this for ``gone_s``: a chair that
            was pushed.
        same_m, same_s: it is nearer to an older one than this, and no older than this,
        double_s: or was never farther apart for this time: two people who embrace are farther apart.
    """

    gone_s: float = 1.0
    unborn_s: float = 0.3
    unsure_m2: float = 0.2
    unsure_certainty: float = 0.35
    same_m: float = 0.3
    same_s: float = 1.0
    double_s: float = 0.5


@dataclasses.dataclass(frozen=True)
class StatureRules:
    """When a stature is measured.

    Attributes:
        every_s: so far apart in time,
        again_s: or, from ``enough`` on, so far.
        kept, needed, enough: at most so many measured statures are kept; from so many on they tell; from so many on
            they are measured less often.
        least_m, least_points, middle_shares: only who is so high, shows so many samples, and has the middle of the
            trunk between these shares of the height stands upright.
        clearance_m: so far above the head nothing may be: it would cut the head off.
        farthest_m: a view from farther than this shows no dark hair, and the head some 10 cm too low.
    """

    every_s: float = 0.06
    again_s: float = 0.4
    kept: int = 60
    needed: int = 6
    enough: int = 30
    least_m: float = 1.0
    least_points: int = 60
    middle_shares: tuple[float, float] = (0.5, 0.75)
    clearance_m: float = 0.1
    farthest_m: float = 3.5


CLUSTERING = ClusteringRules()
MOTION = MotionRules()
PERSON = PersonRules()
END = EndRules()
STATURE = StatureRules()
