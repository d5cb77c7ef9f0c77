# Build the wheels of the service and its client, and an environment that holds nothing but them and
# their dependencies.
FROM python:3.13-slim AS build
WORKDIR /source
# What builds the wheel is pinned too.
ENV PIP_CONSTRAINT=/source/constraints.txt PIP_BUILD_CONSTRAINT=/source/constraints.txt
COPY pyproject.toml README.md LICENSE constraints.txt ./
COPY core core
COPY storage storage
COPY app app
COPY baselines baselines
COPY clients clients
RUN python -m pip wheel --no-cache-dir --no-deps --wheel-dir /wheel clients/python . \
 && python -m venv /opt/tensormap \
 && /opt/tensormap/bin/pip install --no-cache-dir /wheel/tensormap_client-*.whl \
    "$(echo /wheel/tensormap_server-*.whl)[odometry,postgresql,ros]"

FROM python:3.13-slim
COPY --from=build /opt/tensormap /opt/tensormap
RUN useradd --system --uid 10001 --user-group --no-create-home tensormap \
 && install --directory --owner tensormap --group tensormap /data
ENV PATH=/opt/tensormap/bin:$PATH PYTHONDONTWRITEBYTECODE=1 PYTHONUNBUFFERED=1
USER 10001:10001
# No code lies here: what the service imports is what was installed.
WORKDIR /data
VOLUME /data
EXPOSE 8000
HEALTHCHECK --interval=30s --timeout=5s --start-period=30s --retries=3 \
    CMD ["python", "-c", "import urllib.request as u; u.build_opener(u.ProxyHandler({})).open('http://127.0.0.1:8000/readyz', timeout=4)"]
# 0.0.0.0 is no loopback address, so a key is asked for: TENSORMAP_ADMIN_KEY, or one that the first
# start makes and prints once.
CMD ["tensormap", "serve", "--host", "0.0.0.0", "--port", "8000", "--data", "/data"]
