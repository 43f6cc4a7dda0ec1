"""The first tables, and triggers that keep every row as it was written."""

import sqlalchemy as sa
from alembic import op

revision = "v0001"
down_revision = None

TABLES = ("limits", "calibration", "content", "launch")


def upgrade() -> None:
    """Make everything."""
    op.create_table(
        "limits",
        sa.Column("number", sa.Integer, primary_key=True),
        sa.Column("sha256", sa.String(64), nullable=False, unique=True),
        sa.Column("model", sa.Text, nullable=False, index=True),
        sa.Column("file", sa.Text, nullable=False),
        sa.Column("systematic", sa.Text),
        sa.Column("added", sa.DateTime, nullable=False),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "calibration",
        sa.Column("number", sa.Integer, primary_key=True),
        sa.Column("sha256", sa.String(64), nullable=False, unique=True),
        sa.Column("serial", sa.Text, nullable=False),
        sa.Column("model", sa.Text),
        sa.Column("method", sa.Text, nullable=False),
        sa.Column("frame", sa.Text, nullable=False),
        sa.Column("performed", sa.DateTime, nullable=False),
        sa.Column("occasion", sa.String(16), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("limits", sa.Integer, sa.ForeignKey("limits.number")),
        sa.Column("verdict", sa.String(24)),
        sa.Column("supersedes", sa.Integer, sa.ForeignKey("calibration.number"), unique=True),
        sa.Column("reason", sa.Text),
        sa.Column("added", sa.DateTime, nullable=False),
        sqlite_autoincrement=True,
    )
    op.create_index("calibration_of_device", "calibration", ["serial", "performed", "number"])
    op.create_table(
        "content",
        sa.Column("calibration", sa.Integer, sa.ForeignKey("calibration.number"), primary_key=True),
        sa.Column("file", sa.Text, nullable=False),
    )
    op.create_table(
        "launch",
        sa.Column("calibration", sa.Integer, sa.ForeignKey("calibration.number"), primary_key=True),
        sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("session", sa.Text),
        sa.Column("log_sha256", sa.Text, nullable=False, index=True),
    )
    _forbid_changes(op.get_bind().dialect.name)


def _forbid_changes(dialect: str) -> None:
    said = "a registry is added to, never changed"
    if dialect == "sqlite":
        for table in TABLES:
            for change in ("UPDATE", "DELETE"):
                op.execute(
                    f"CREATE TRIGGER {table}_no_{change.lower()} BEFORE {change} ON {table} "
                    f"BEGIN SELECT RAISE(ABORT, '{said}'); END"
                )
        return
    op.execute(
        f"CREATE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN RAISE EXCEPTION '{said}'; END $$"
    )
    for table in TABLES:
        op.execute(
            f"CREATE TRIGGER {table}_is_kept BEFORE UPDATE OR DELETE OR TRUNCATE ON {table} "
            "FOR EACH STATEMENT EXECUTE FUNCTION refuse_change()"
        )
