# Images of a release: `core` denoises files, `farm` is a scheduler or a worker of Dask. The wheel lies in dist/.
# docs/developers/releasing.md says how to build and run them.
FROM python:3.13-slim-trixie AS core
RUN --mount=type=bind,source=dist,target=/dist \
    pip install --no-cache-dir --no-compile "$(ls /dist/lobewise-*manylinux*_"$(uname -m)".whl)[best]" \
    && useradd --uid 1000 --create-home lobewise
# All filters are in the wheel. Any user can run the image, also one without a folder for a cache.
ENV LOBEWISE_CACHE=off PYTHONUNBUFFERED=1
USER 1000
WORKDIR /work
ENTRYPOINT ["lobewise"]
CMD ["--help"]

FROM core AS farm
USER 0
RUN --mount=type=bind,source=dist,target=/dist \
    pip install --no-cache-dir --no-compile "$(ls /dist/lobewise-*manylinux*_"$(uname -m)".whl)[best,farm]"
USER 1000
ENTRYPOINT []
CMD ["dask", "--help"]
