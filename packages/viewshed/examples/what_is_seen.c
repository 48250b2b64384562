/* What a sweep can see: cc what_is_seen.c $(pkg-config --cflags --libs viewshed) && ./a.out SWEEP.bin
 * The file holds x, y, z, intensity as float32, as KITTI's do: x forward, y left, z up, in meters. */
#include <stdio.h>
#include <stdlib.h>
#include <viewshed.h>

static int failed(const char *what) {
    fprintf(stderr, "%s: %s\n", what, viewshed_error());
    return 1;
}

int main(int argc, char **argv) {
    static float rows[4 * 1000000];
    static uint8_t state[256 * 256];
    FILE *file = argc == 2 ? fopen(argv[1], "rb") : NULL;
    if (file == NULL) return fprintf(stderr, "usage: %s SWEEP.bin\n", argv[0]), 2;

    viewshed_sweep sweep = viewshed_no_sweep();
    sweep.count = fread(rows, 16, 1000000, file);
    sweep.points = rows;
    sweep.point_step = 16;
    const int is_whole = sweep.count > 0 && feof(file);
    fclose(file);
    if (!is_whole) return fprintf(stderr, "%s: must be a file of points of 16 bytes, fewer than a million\n", argv[1]), 2;

    viewshed_stream stream;
    viewshed_options options = viewshed_defaults();
    viewshed_basis basis;
    if (viewshed_open(&options, &stream)) return failed("open");
    if (viewshed_estimate(stream, &sweep, state, NULL, 256 * 256, &basis)) return failed("estimate");
    viewshed_close(stream);

    size_t cells[4] = {0};
    for (size_t n = 0; n < sizeof state; ++n) ++cells[state[n]];
    printf("%zu points, sensor %s, %.2f m above the ground, reach %.0f m\n", sweep.count,
           basis.sensor[0] ? basis.sensor : "not known", basis.sensor_height_m, basis.reach_m);
    printf("unknown %zu, free %zu, surface %zu, hidden %zu cells\n", cells[0], cells[1], cells[2], cells[3]);
    return 0;
}
