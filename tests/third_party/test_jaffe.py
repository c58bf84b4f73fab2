from streamkit_jaffe import Jaffe

from streamkit.testing import check


def test_jaffe():
    check(Jaffe)
