# The server on the simulated rig. Build: docker build -t mrnav-server .
# PIP_FLAGS may name an index that has torch built for the CPU alone, which saves gigabytes:
#   docker build --build-arg PIP_FLAGS="--extra-index-url URL" -t mrnav-server .

FROM python:3.11-slim AS build
ARG PIP_FLAGS=""
WORKDIR /source
COPY . .
RUN python -m venv /opt/mrnav \
    && /opt/mrnav/bin/pip install --no-cache-dir --disable-pip-version-check $PIP_FLAGS '.[study]'

FROM python:3.11-slim
RUN useradd --uid 10001 --create-home mrnav && install -d -o mrnav -g mrnav /trials
COPY --from=build /opt/mrnav /opt/mrnav
ENV PATH=/opt/mrnav/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    OMP_NUM_THREADS=1 \
    MRNAV_SERVER__HOST=0.0.0.0 \
    MRNAV_SERVER__INSECURE=true \
    MRNAV_RECORDING__ROOT=/trials
USER mrnav
WORKDIR /home/mrnav
VOLUME /trials
EXPOSE 8000 9000
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=10s --timeout=3s --start-period=60s --retries=3 \
    CMD ["python", "-c", "import urllib.request as u; u.urlopen('http://127.0.0.1:8000/healthz', timeout=2)"]
CMD ["mrnav", "serve"]
