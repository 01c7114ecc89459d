# soil_env with the CPU build of torch and the pinned versions: every command of the package but --engine ray, as a
# user without rights.
#   docker build -t soil_env .
#   docker run --rm soil_env train --help
#   docker run --rm -v "$PWD":/work --user "$(id -u)" soil_env discover rig.csv --setup rig.setup.yaml --out result

FROM python:3.11-slim AS build
WORKDIR /src
COPY pyproject.toml setup.py README.md LICENSE ./
COPY soil_env soil_env
COPY agents agents
COPY configs configs
COPY examples examples
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /dist .

FROM python:3.11-slim
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
ENV PYTHONUNBUFFERED=1 MPLBACKEND=Agg SDL_VIDEODRIVER=dummy SDL_AUDIODRIVER=dummy \
    NUMBA_CACHE_DIR=/var/cache/soil_env/numba MPLCONFIGDIR=/var/cache/soil_env/matplotlib \
    HOME=/work USER=soil LOGNAME=soil

# torch alone and first: PyPI's build for Linux brings several GB of CUDA libraries.
COPY constraints.txt /tmp/constraints.txt
RUN pip install --no-cache-dir --no-deps --index-url "$TORCH_INDEX" \
        "$(sed -n 's/^\(torch==[^ ]*\).*/\1/p' /tmp/constraints.txt)"
COPY --from=build /dist /tmp/dist
RUN pip install --no-cache-dir -c /tmp/constraints.txt "$(ls /tmp/dist/soil_env-*.whl)[train,export,logs,video]" \
    && rm -rf /tmp/dist /tmp/constraints.txt

# The kernels are compiled here once. Whoever runs the image (--user) may add to the caches.
RUN useradd --no-create-home --home-dir /work soil \
    && mkdir -p /work "$NUMBA_CACHE_DIR" "$MPLCONFIGDIR" \
    && soil-env warmup \
    && chmod -R a+rwX /var/cache/soil_env \
    && chown soil /work

USER soil
WORKDIR /work
ENTRYPOINT ["soil-env"]
CMD ["--help"]
