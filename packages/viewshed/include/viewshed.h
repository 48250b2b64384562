/* libviewshed: what a LiDAR sweep can see, cell by cell, from C. The same stages as the Python package, and the same answers.
 *
 * A stream is opened for a grid, a target and a sensor, is given sweeps, and is closed. Frames: points in the sensor's own frame
 * (x forward, y left, z up, the sensor at the origin), answers in the level frame (upright, below the sensor, heading of the
 * sensor's x). Cell (i, j) of a grid stands at i * cells + j, i forward and j left.
 *
 * Every function returns a viewshed_status and never throws, aborts or keeps a pointer of the caller. All may be called from
 * any thread; calls for one stream wait for each other. */
#ifndef VIEWSHED_H
#define VIEWSHED_H

#include <stddef.h>
#include <stdint.h>

#if defined(__GNUC__)
#define VIEWSHED_API __attribute__((visibility("default")))
#else
#define VIEWSHED_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
    VIEWSHED_OK = 0,
    VIEWSHED_ERROR_ARGUMENT = 1, /* viewshed_error() says which, the rule, and what was given */
    VIEWSHED_ERROR_STREAM = 2,   /* the stream was never opened, or is closed */
    VIEWSHED_ERROR_ROOM = 3,     /* an array is too short; the counts say what is needed */
    VIEWSHED_ERROR_MEMORY = 4,
    VIEWSHED_ERROR_INTERNAL = 5  /* a fault of the library */
} viewshed_status;

/* What is known of a cell. Visible means FREE or SURFACE; UNKNOWN says nothing. */
enum { VIEWSHED_UNKNOWN = 0, VIEWSHED_FREE = 1, VIEWSHED_SURFACE = 2, VIEWSHED_HIDDEN = 3 };

/* Where the sensor's height is from. */
enum { VIEWSHED_HEIGHT_GIVEN = 0, VIEWSHED_HEIGHT_ESTIMATED = 1, VIEWSHED_HEIGHT_ASSUMED = 2 };

/* A stream: a number, not an address, so that one that is closed is never mistaken for another. 0 is none. */
typedef uint64_t viewshed_stream;

/* What a stream is about. Set it up by viewshed_defaults(), then change what differs. */
typedef struct {
    uint32_t cells;         /* of a side, 1 to 4096; 256 */
    double half_extent_m;   /* half the side of the grid; 64 */
    double offset_m[2];     /* of the grid's center from the sensor; 0, 0 */
    double target_width_m;  /* the target that would have to be seen, a car: 1.8 */
    double target_height_m; /* 1.5 */
    uint32_t min_returns;   /* returns from which on it counts as seen; 5 */
    const char *sensor;     /* its beam table ("vlp16", "hdl32e"), null: inferred from the points, or "none": not inferred */
} viewshed_options;

/* One revolution. Set it up by viewshed_no_sweep(), then name the points and what is known. */
typedef struct {
    size_t count;           /* of the points; at most 20 million */
    const void *points;     /* x, y, z float32 in meters; rows that are not finite are left out */
    size_t point_step;      /* bytes from a point to the next, 12 or more; 0 means 12 */
    const void *ring;       /* uint16 beam of each point, 0 the lowest; or null: recovered from the points */
    size_t ring_step;       /* bytes from a ring to the next, 2 or more; 0 means 2 */
    const double *attitude; /* unit quaternion w, x, y, z of level_from_sensor, or null: estimated */
    double sensor_height_m; /* above the ground below, or NaN: estimated */
    double vehicle_yaw;     /* heading of the own vehicle from the sensor's x in radians, or NaN: estimated */
} viewshed_sweep;

/* What an estimate rests on. */
typedef struct {
    double sensor_height_m;      /* above the ground below the sensor */
    int32_t height_source;       /* VIEWSHED_HEIGHT_... */
    double ground_support;       /* share of the near ground on the plane that carries the sensor */
    double unsure_ground_share;  /* share of the claims on ground that is unsure by more than half a meter */
    double inferred_share;       /* share of the claims that measured beams alone would not support */
    double reach_m;              /* nothing is claimed beyond */
    double level_from_sensor[9]; /* rotation, row by row */
    size_t dropped_points;       /* rows that were not finite */
    char sensor[32];             /* the beam table that was given or inferred, or empty */
} viewshed_basis;

VIEWSHED_API const char *viewshed_version(void);

/* Why the last call of this thread failed, in a line; empty where it did not. Valid until the next call. */
VIEWSHED_API const char *viewshed_error(void);

/* How many threads a stage may use, 1 to 4, in all streams. */
VIEWSHED_API viewshed_status viewshed_set_threads(size_t count);

VIEWSHED_API viewshed_options viewshed_defaults(void);
VIEWSHED_API viewshed_sweep viewshed_no_sweep(void);

VIEWSHED_API viewshed_status viewshed_open(const viewshed_options *options, viewshed_stream *stream);

/* Write the state (cells * cells) and, unless null, the probability that a target in each cell would be seen, and the basis. */
VIEWSHED_API viewshed_status viewshed_estimate(viewshed_stream stream, const viewshed_sweep *sweep, uint8_t *state,
                                               float *visible_prob, size_t cells, viewshed_basis *basis);

/* Write the outline of what the last estimate without an error calls visible (a probability of at least one half): rings of
 * corners x, y in meters, the last one joined to the first. Ring k has the corners [begin[k], begin[k + 1]). Rings of one region have the same
 * number, negative where the ring is a hole. Arrays that are too short leave VIEWSHED_ERROR_ROOM and the counts that are needed;
 * begin has one element more than there are rings. */
VIEWSHED_API viewshed_status viewshed_outline(viewshed_stream stream, double *corners_m, size_t corner_room, int64_t *begin,
                                              int32_t *region, size_t ring_room, size_t *corner_count, size_t *ring_count);

VIEWSHED_API viewshed_status viewshed_close(viewshed_stream stream);

#ifdef __cplusplus
}
#endif

#endif
