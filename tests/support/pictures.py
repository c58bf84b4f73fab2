"""What a picture really prints, and whether it can be read."""

from itertools import combinations

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text


def drawn_texts(figure, monkeypatch):
    """Return every text that the figure really draws, with its box in pixels."""
    result, draw = [], Text.draw

    def record(text, renderer):
        if text.get_visible() and text.get_text().strip():
            result.append((text.get_text(), text.get_window_extent(renderer)))
        draw(text, renderer)

    with monkeypatch.context() as patch:
        patch.setattr(Text, "draw", record)
        FigureCanvasAgg(figure).draw()
    return result


def overlap(a, b, pixels=0.5):
    return min(a.x1, b.x1) - max(a.x0, b.x0) > pixels and min(a.y1, b.y1) - max(a.y0, b.y0) > pixels


def assert_readable(figure, monkeypatch, over_panels=()):
    """Assert that all texts lie inside the figure, off each other, and off the panels but for those named."""
    texts = drawn_texts(figure, monkeypatch)
    panels = [axes.get_window_extent() for axes in figure.axes if axes.get_visible() and axes.get_frame_on()]
    for text, box in texts:
        assert box.x0 >= 0, text
        assert box.y0 >= 0, text
        assert box.x1 <= figure.bbox.x1, text
        assert box.y1 <= figure.bbox.y1, text
        assert text in over_panels or not any(overlap(box, panel) for panel in panels), text
    for (one, a), (other, b) in combinations(texts, 2):
        assert not overlap(a, b), (one, other)
    return [text for text, _ in texts]
