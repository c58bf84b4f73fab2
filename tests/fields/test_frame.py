"""`streamkit.Frame` as the type of a component's field."""

from typing import Any, ClassVar

import numpy as np
import pytest
from pydantic import ValidationError
from runfiles import changed, schema_with

import streamkit as sk
from streamkit.components import load_registry

ROWS = ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
FRAMES = ["GD1Koposov10", {"pole": [192.86, 27.13], "origin": [266.4, -28.94]}, [list(row) for row in ROWS]]


class Latitude(sk.Observable):
    """The mean latitude in a frame."""

    kind = "latitude"
    example: ClassVar[dict[str, Any]] = {"frame": "GD1Koposov10"}
    frame: sk.Frame = None

    def data(self) -> Any:
        return np.zeros(1), np.ones(1)

    def predict(self, stream: sk.Stream) -> sk.Prediction:
        return sk.Prediction(("phi2",), np.array([stream.seen(self.frame).phi2.mean()]), np.ones(1))


@pytest.mark.parametrize("frame", FRAMES)
def test_a_frame_is_read_from_a_run_file_written_and_read_again(frame):
    spec = sk.load(changed("observable", {"kind": "latitude", "frame": frame}), components=[Latitude])
    assert spec.document["observable"]["frame"] == frame
    assert sk.load(spec.document, components=[Latitude]).digest() == spec.digest()
    np.testing.assert_array_equal(sk.sky_matrix(spec.bind().observable.frame), sk.sky_matrix(frame))


def test_a_frame_may_be_left_out_or_given_as_an_array():
    assert Latitude().frame is None
    assert Latitude(frame=np.array(ROWS)).frame == ROWS


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        ("GD1Koposov1", "Did you mean 'GD1Koposov10'"),
        ({"pole": [0.0, 90.0]}, "takes pole and origin"),
        ([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], "is no rotation"),
    ],
)
def test_what_is_no_frame_is_refused_with_a_sentence(frame, message):
    with pytest.raises(ValidationError, match=message):
        Latitude(frame=frame)
    with pytest.raises(sk.SpecError, match=message):
        sk.load(changed("observable", {"kind": "latitude", "frame": frame}), components=[Latitude])


def test_the_json_schema_describes_the_three_forms():
    schema = schema_with(load_registry(classes=[Latitude]))
    forms = schema["$defs"]["observable.latitude"]["properties"]["frame"]["anyOf"]
    assert [form["type"] for form in forms] == ["string", "object", "array"]
