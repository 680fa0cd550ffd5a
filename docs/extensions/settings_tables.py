"""The directive `settings-tables`: every setting in conf/, its default, and what the comment beside it says."""

from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from pinn_cli.cli.schema import Setting, SettingsFile, explained

CONF = Path(__file__).parents[2] / "conf"
GROUPS = (
    "system", "excitation", "model_error", "data", "scheme", "network", "training", "posterior", "validation",
    "baseline", "tracking", "hydra/launcher", "hydra/sweeper",
)  # fmt: skip


def cell(*content: nodes.Node) -> nodes.entry:
    """One cell of a table."""
    return nodes.entry("", nodes.paragraph("", "", *content))


def spoken(comment: str) -> list[nodes.Node]:
    """A comment as text; what it has in backticks is code."""
    parts = comment.split("`")
    return [nodes.literal("", part) if i % 2 else nodes.Text(part) for i, part in enumerate(parts)]


def table(settings: list[Setting], prefix: str) -> nodes.table:
    """Settings by their full names, their defaults and meanings."""
    group = nodes.tgroup(cols=3)
    group += [nodes.colspec(colwidth=width) for width in (25, 15, 60)]
    head = nodes.row("", *(cell(nodes.Text(title)) for title in ("setting", "default", "meaning")))
    body = nodes.tbody()
    for setting in settings:
        default = [nodes.literal("", setting.default)] if setting.default else []
        body += nodes.row(
            "",
            cell(nodes.literal("", f"{prefix}{setting.name}")),
            cell(*default),
            cell(*spoken(setting.meaning)),
        )
    group += [nodes.thead("", head), body]
    return nodes.table("", group, classes=["colwidths-auto"])


def shown(found: SettingsFile) -> list[Setting]:
    """Those with a value of their own, or something said of all that stands below them."""
    return [setting for setting in found.settings if setting.default or setting.meaning]


class SettingsTables(SphinxDirective):
    """A section for each group of conf/, in it one for each option."""

    def run(self) -> list[nodes.Node]:
        """Read the files anew: they are what a run reads."""
        sections = [self._section("general", "General", [table(shown(explained(self._file("config.yaml"))), "")])]
        for group in GROUPS:
            options = [self._option(group, file) for file in sorted((CONF / group).glob("*.yaml"))]
            sections.append(self._section(group, group, options))
        return sections

    def _file(self, name: str) -> Path:
        file = CONF / name
        self.env.note_dependency(str(file))
        return file

    def _option(self, group: str, file: Path) -> nodes.section:
        found = explained(self._file(f"{group}/{file.name}"))
        content: list[nodes.Node] = [nodes.paragraph("", "", *spoken(found.title))] if found.title else []
        if found.commands:
            text = "\n".join(found.commands)
            content.append(nodes.literal_block(text, text, language="text"))
        if settings := shown(found):
            prefix = group.replace("/", ".") + "."
            content.append(table(settings, prefix))
        common = file.stem.startswith("_")
        title = f"{group}: what all {file.stem.strip('_')} records share" if common else f"{group}={file.stem}"
        return self._section(f"{group}-{file.stem}", title, content)

    def _section(self, name: str, title: str, content: list[nodes.Node]) -> nodes.section:
        return nodes.section("", nodes.title(title, title), *content, ids=[nodes.make_id(f"settings-{name}")])


def setup(app: Sphinx) -> dict[str, bool]:
    """Sphinx calls this."""
    app.add_directive("settings-tables", SettingsTables)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
