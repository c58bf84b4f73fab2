"""One stream: the case of figure 5 of Gibbons, Belokurov & Evans 2014.

    python examples/one_stream.py [PARTICLES [PICTURE.png]]

A Plummer satellite in an NFW halo, on an orbit between 18 and 70 kpc, stripped for 4.31 Gyr (4 pericentres).
"""

import sys
from pathlib import Path

import streamkit as sk
from streamkit.report import draw_stream, save_picture

particles = int(sys.argv[1]) if len(sys.argv) > 1 else 12660
picture = Path(sys.argv[2]) if len(sys.argv) > 2 else Path("one_stream.png")

# The same sections as a run file. A number is in the field's own unit; astropy quantities work too.
spec = sk.load(
    {
        "seed": 1,
        "potential": {"kind": "nfw_m200", "m200": "7.5e11 Msun", "c200": 20, "h0": 70},
        "progenitor": {
            "kind": "plummer",
            "mass": "6.4e8 Msun",
            "radius": "0.85 kpc",
            # Today, in kpc and km/s: where this orbit is 4.31 Gyr after its apocentre at x = 70 kpc.
            "x": 5.70213354,
            "y": -42.38622646,
            "z": 0,
            "vx": 147.50775245,
            "vy": -119.20085322,
            "vz": 0,
            "lookback": "4.31 Gyr",
        },
        "stripping": {"kind": "mlcs", "particles": particles, "sigma": "10 km/s"},
        # The paper's own N-body stream as data; the errors only scale the differences printed below.
        "observable": {
            "kind": "apocentres",
            "leading": ["53.6 kpc", "1 kpc"],
            "trailing": ["92.6 kpc", "1 kpc"],
            "precession": ["119.5 deg", "1 deg"],
        },
    }
)

inputs = spec.bind()
stream = sk.Model(spec).stream()
prediction = inputs.observable.predict(stream)

print(stream.table())  # an astropy QTable: position, velocity, release and stripping time, winding, arm
print(f"{stream.bound.mean():.1%} of {len(stream)} particles never left the satellite")
print(prediction.why_not or "            mLCS             N-body (paper)")
for name, value, variance, nbody in zip(
    prediction.names, prediction.mean, prediction.variance, inputs.observable.data()[0], strict=True
):
    print(f"{name:10s} {value:6.1f} +- {variance**0.5:.1f}  {nbody:14.1f}")

save_picture(picture, draw_stream(stream, prediction, inputs))
print(f"picture: {picture}")
