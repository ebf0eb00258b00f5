"""What stored warnings, verdicts of panels and rules of acceptance say (see `dashboard.reasons`)."""

SENTENCES = (
    "every finding of the scan is decided, and no work is open",
    "panel {panel} released with 1 scan; verdict {verdict}: {reason}",
    "panel {panel} released with 1 scan; verdict {verdict}",
    "panel {panel} released with {n} scans; verdict {verdict}: {reason}",
    "panel {panel} released with {n} scans; verdict {verdict}",
    "first scan of station {station}: the rivets ({rivets}) and seams ({seams}) found in it were enrolled as the "
    "panel's pattern; check that none is missing",
    "first scan of station {station}: not enrolled as the panel's pattern, since {cause}; scan it again",
    "judged by the example limits, which are nobody's requirement; give --panel-spec",
    "judged by the example limits, which are nobody's requirement; put a specification in force",
    "judged by the specification of panel {panel}, though the scene is of {other}",
    "outside the projector's field, at least in part: {names}",
    "inspected with rig {rig} though the scene names {other}",
    "the same frames are stored as {names} and {n} more: one of these names at most is right",
    "the same frames are stored as {names}: one of these names at most is right",
    "overexposed: {share} of the skin is saturated in every exposure of the right camera; rivets and seams there are "
    "not found or not measured; take a shorter exposure as well",
    "overexposed: {share} of the skin is saturated in every exposure; rivets and seams there are not found or not "
    "measured; take a shorter exposure as well",
    "{share} of the lit pixels of the {camera} camera have fringes that contradict each other and therefore no points; "
    "look for movement, reflections of the fringes, or a frame of another scan",
    "faint: the {camera} camera's fringes have {n} grey levels (of {step} each), expected {least} at least; rounding "
    "may show as defects and steps that are none, and gaps are not measured; expose longer, look at focus and other "
    "light, and let the files keep all bits of the camera",
    "blurred: the {camera} camera's fringes are blurred by {blur} px, expected at most {limit}; gaps are not "
    "measured, heights and steps beside edges may be off; did something move while it exposed, or is the camera or "
    "the projector out of focus? Scan again at rest; whoever turns a focus ring calibrates again",
    "the {camera} camera's pictures bear waves or stripes that change from frame to frame (pixels far apart share "
    "{share} of their noise, and means of columns and blocks scatter {n} times as far as a sensor's, expected none "
    "and 1.0): what looks like a dent or a bump may be none; look for a beat (moiré) of camera and projector, a lamp "
    "that flickers, or the camera's readout",
    "the {camera} camera's pictures were smoothed, scaled or compressed (neighbouring pixels share {share} of their "
    "noise, expected none): U95 allows for that, gaps are not measured, and what looks like a dent or a bump may be "
    "none; keep pictures as the sensor gives them, without filters and JPEG",
    "the {camera} camera sees a second, fainter picture of the fringes (phases of its counts miss each other by "
    "{miss} rad, expected at most {least}): what looks like a dent or a bump may be none; look for a reflection "
    "within the lens, its filter or a window, or from something bright beside the skin, and for movement between "
    "the counts",
    "the brightness of the {camera} camera's frames changes from row to row, in each frame another way ({share}, "
    "expected at most {least}): what looks like a dent or a bump may be none; light flickers while the shutter "
    "rolls: expose for whole periods of the light, or take a global shutter",
    "veiled: the cameras' fringes differ in contrast by {share} more in a part of the picture than what changes "
    "smoothly over it, expected at most {most}: what looks like a dent or a bump may be none; look for stray light or "
    "dirt on one camera's lens or its window, and for a lamp that shines into it",
    "light bent locally (places: {n}, the worst {width} × {height} px around u {u}, v {v} in the left picture): the "
    "projector coordinate is up to {off} px off what the rig says, expected at most {limit}: what looks like a dent or "
    "a bump there may be none; look for a drop, dirt or stray light on a lens or its window (either camera's or the "
    "projector's), and for fringes that mirror in something; clean them and scan again",
    "{share} of the field in view have no points (the largest part, around u {u}, v {v} in the left picture, is "
    "{cause}): what lies there was not inspected; is something before the skin, or does it reflect?",
    "the {camera} camera's pictures were sharpened (their noise averages out {n} times as fast as a sensor's): gaps "
    "are not measured, and steps and heights beside edges may be off; switch the camera's sharpening off",
    "the cameras see fringes of different shape (harmonics of {first} and {last} of their amplitude, expected the "
    "same): one of them has a gamma or contrast curve; the ripple that it makes was taken out; let both cameras give "
    "linear grey levels",
    "the frames of the {camera} camera are uneven in another way than the other camera's (a blurred frame, a late "
    "trigger, light that flickers): the ripple that they make was taken out; look at triggers and light",
    "overexposed: the crests of the {camera} camera's fringes are cut off in {share} of its pixels, expected at most "
    "{least} where fringes are no sinusoids (harmonics of {n}): what looks like a dent or a bump may be none; take a "
    "shorter exposure, or one as well; is the camera's black level raised?",
    "cut off at black: {share} of the {camera} camera's lit pixels are 0 for a quarter of a fringe and more, expected"
    " none: dark edges lie elsewhere in such pictures, and gaps are not measured; raise the camera's black level",
    "panel's pattern not recognised: {cause}, expected most; ids are this scan's own; is this the right station?",
    "panel's pattern fits in two ways almost alike, expected one: ids may be shifted; see to the station's nominal "
    "placement",
    "rig found {shift} mm and {turn}° from the station's nominal placement, expected at most {limit} mm and {most}°",
    "rivets of the panel's pattern in view but not found: {names}",
    "heads of another size than the pattern's: {n} of {all}; is this the right station?",
    "rig {rig} has one camera: gaps' edges and heads' rims come from points and rings alone, and a glint or a shadow "
    "may be taken for a head's rim",
    "rig {rig} has no calibrated projector: the overlay is drawn over the left camera's picture",
    "rig {rig} has no calibrated projector: the overlay is drawn over the left camera's picture, gaps' edges and "
    "heads' rims come from points and rings alone, and neither a small yaw between the cameras nor a wrong scale of "
    "all lengths would be noticed (flushline measure)",
    "rig {rig} has a projector of which scans told the columns or the rows alone: the overlay is drawn over the left "
    "camera's picture, gaps' edges and heads' rims come from points and rings alone",
    "rig {rig} was given with other values than the store has for that id; a calibration needs an id of its own",
    "rig {rig}: verifications cannot be read ({cause})",
    "rig {rig}: points lie {off} px off the rays of their pixels, expected at most {limit} px: give the rig of the "
    "camera that took the picture",
    "frames of the {camera} camera hardly fit each other ({share} of what is refused): look for light that flickers "
    "or changes, dark parts cut off at black, movement, or a blurred frame",
    "rig {rig}: calibration overdue since {day}",
    "rig {rig}: never verified",
    "rig {rig}: not verified before",
    "rig {rig}: verified with another calibration of the same id only",
    "rig {rig}: overdue: its last verification held until {day} ({name})",
    "rig {rig}: failed its last verification ({name}: {cause})",
    "rig {rig}: cannot tell whether the rig still fits: {cause}",
    "rig {rig}: texture lies off the epipolar lines by {off} px RMS, expected at most {limit} px: {advice}",
    "rig {rig}: the decoded projector coordinate is off by {off} px RMS, expected at most {limit} px: {advice}",
    "captured_at {time} is {span} ahead of this computer's clock; it counts as the station's newest scan only where "
    "there is no other; check the camera's clock",
    "captured_at {time} is {span} before rig {rig} was calibrated ({calibrated}); check the camera's clock and the rig "
    "that the scene names",
    "found {n} parts that nothing joins ({stations}), expected one: scan between them with an overlap that shows three "
    "fasteners and more, or give nominal positions; is each scan of this panel?",
    "found {n} parts that nothing joins ({stations}); {unsure} fit together in several ways, expected one: scan "
    "between them with an overlap that shows three fasteners and more, or give nominal positions; is each scan of this "
    "panel?",
    "{station} left out: {cause}",
    "{station} and {other}: found their shared heads more than {limit} mm apart in the joint placement, expected them "
    "together; their overlap was not used",
    "names and places of {stations} are not those of the assembly before: they were not found again in it",
)
"""Whole texts; the first that fits is taken."""

CLAUSES = (
    "the specification has no acceptance rules",
    "from {first} to {last} mm ({length} mm): {reason}",
    "at {place} mm: {reason}",
    "worst {quantity} {value} ± {u95} {unit} at {place} mm, expected {limit}",
    "beyond limits that no rule allows to exceed: {names}",
    "within U95 of a limit: {names}",
    "not seen: {names}",
    "not seen",
    "not measured: {names}",
    "in {n} parts",
    "{station} left out",
    "{n} not measured",
    "{said}: found {amount} of {group}, up to {doubtful} with what lies within the guard band",
    "{said}: found {amount}, up to {doubtful} with what lies within the guard band",
    "{said}: found {amount} of {group}",
    "{said}: found {amount}",
    "{rule}: {said}",
    "at most {share} of the {many} of a {per} with {what}",
    "at most {n} adjacent {many} with {what}",
    "at most {n} {many} of a {per} with {what}",
    "at most {n} {many} per m² with {what}",
    "at most {length} mm of a {subject} with {what}",
    "no stretch of a {subject} longer than {length} mm with {what}",
    "mean {quantity} over {length} mm within its limits",
    "{quantity} beyond its limit",
    "{quantity} beyond its serious limit",
    "{quantity} of any value",
    "calibrate the rig again",
    "scan again first, as these frames are odd, and calibrate the rig again only where that stays so",
    "fringes of the {camera} camera blurred by {blur} px",
    "its frames are stored under another name",
    "fringes of the {camera} camera of {n} grey levels, whose rounding may look like it",
    "pictures of the {camera} camera with waves or stripes that change from frame to frame",
    "pictures of the {camera} camera smoothed, scaled or compressed",
    "pictures of the {camera} camera sharpened",
    "pictures of the {camera} camera cut off at black",
    "crests of the {camera} camera's fringes cut off",
    "a second picture of the fringes in the {camera} camera",
    "fringes of one camera veiled in a part of its picture",
    "light bent locally: the projector coordinate is up to {off} px off",
    "saturated",
    "too dark or without fringes",
    "with fringes that contradict each other",
    "without a counterpart in the other camera",
    "out of range",
    "frames of the {camera} camera whose brightness changes from row to row",
)
"""Clauses of verdicts and rules."""

WORDS = ("any quantity", "course", "row", "zone", "left", "right", "left and right", "not put together")
"""Words in their places that nothing else declares."""
