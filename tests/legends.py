"""What the legend of a figure says, and whether it fits."""

from matplotlib.figure import Figure, SubFigure


def texts(figure: Figure | SubFigure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def fit(figure: Figure) -> bool:
    """Whether all legends, those of its parts too, lie within it."""
    figure.draw_without_rendering()
    legends = [legend for part in figure.subfigs or [figure] for legend in part.legends]
    extents = [legend.get_window_extent() for legend in legends]
    return bool(extents) and all(0.0 < extent.x0 < extent.x1 < figure.bbox.x1 for extent in extents)
