"""Run by alembic: the migrations of this folder, in the transaction of the connection that `schema` gives."""

from alembic import context

from tumble.registry.schema import METADATA, VERSION_TABLE

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=METADATA,
    version_table=VERSION_TABLE,
    transactional_ddl=True,
)
context.run_migrations()
