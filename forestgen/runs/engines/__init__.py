"""Who does the jobs: processes of this machine (`local`), or a Dask cluster (`dask`)."""
