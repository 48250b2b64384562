/* libviewshed: C interface that estimates which cells of a grid a LiDAR sweep can see. The stages and the results are those
 * of the Python package.
 *
 * Open a stream for a grid, a target and a sensor, give it sweeps, and close it. Points are in the sensor's frame (x forward,
 * y left, z up, the sensor at the origin). Results are in the level frame (upright, origin on the ground below the sensor,
 * heading of the sensor's x). Cell (i, j) of a grid is at index i * cells + j, i forward and j left.
 *
 * No function throws, aborts or keeps a pointer of the caller; those that can fail return a viewshed_status. All may be called
 * from any thread; calls for one stream wait for each other. */
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
    VIEWSHED_ERROR_ARGUMENT = 1, /* viewshed_error() names the argument, the rule and the value */
    VIEWSHED_ERROR_STREAM = 2,   /* the stream was never opened, or is closed */
    VIEWSHED_ERROR_ROOM = 3,     /* an array is too short; the counts give the required sizes */
    VIEWSHED_ERROR_MEMORY = 4,
    VIEWSHED_ERROR_INTERNAL = 5  /* a bug in the library */
} viewshed_status;

/* State of a cell. Visible means FREE or SURFACE; UNKNOWN makes no claim. */
enum { VIEWSHED_UNKNOWN = 0, VIEWSHED_FREE = 1, VIEWSHED_SURFACE = 2, VIEWSHED_HIDDEN = 3 };

/* Source of the sensor's height. */
enum { VIEWSHED_HEIGHT_GIVEN = 0, VIEWSHED_HEIGHT_ESTIMATED = 1, VIEWSHED_HEIGHT_ASSUMED = 2 };

/* Handle of a stream: a number, not an address, so that a closed stream is never mistaken for another. 0 is no stream. */
typedef uint64_t viewshed_stream;

/* Settings of a stream. Initialize with viewshed_defaults(), then change what differs. */
typedef struct {
    uint32_t cells;         /* along one side, 1 to 4096; 256 by default */
    double half_extent_m;   /* half the side of the grid; 64 */
    double offset_m[2];     /* offset of the grid's center from the sensor; 0, 0 */
    double target_width_m;  /* width of the target that must be seen; 1.8, a car */
    double target_height_m; /* height of the target; 1.5 */
    uint32_t min_returns;   /* minimum returns for a target to count as seen; 5 */
    const char *sensor;     /* beam table ("vlp16", "hdl32e"); null to infer it from the points, "none" not to infer it */
} viewshed_options;

/* One revolution. Initialize with viewshed_no_sweep(), then set the points and what is known. */
typedef struct {
    size_t count;           /* number of points; at most 20 million */
    const void *points;     /* x, y, z float32 in meters; rows that are not finite are dropped */
    size_t point_step;      /* bytes from one point to the next, 12 or more; 0 means 12 */
    const void *ring;       /* uint16 beam of each point, 0 is the lowest; null to recover it from the points */
    size_t ring_step;       /* bytes from one ring to the next, 2 or more; 0 means 2 */
    const double *attitude; /* unit quaternion w, x, y, z of level_from_sensor; null to estimate it */
    double sensor_height_m; /* above the ground below; NaN to estimate it */
    double vehicle_yaw;     /* heading of the own vehicle from the sensor's x in radians; NaN to estimate it */
} viewshed_sweep;

/* What an estimate rests on. */
typedef struct {
    double sensor_height_m;      /* above the ground below the sensor */
    int32_t height_source;       /* VIEWSHED_HEIGHT_... */
    double ground_support;       /* share of the near ground on the plane below the sensor */
    double unsure_ground_share;  /* share of the claims on ground uncertain by more than half a meter */
    double inferred_share;       /* share of the claims that measured beams alone do not support */
    double reach_m;              /* nothing is claimed beyond it */
    double level_from_sensor[9]; /* rotation matrix, row by row */
    size_t dropped_points;       /* rows that were not finite */
    char sensor[32];             /* name of the given or inferred beam table, or empty */
} viewshed_basis;

VIEWSHED_API const char *viewshed_version(void);

/* Return one line on why this thread's last call failed; empty if it did not. Valid until this thread's next call. */
VIEWSHED_API const char *viewshed_error(void);

/* Set the number of threads that a stage may use, 1 to 4, for all streams. */
VIEWSHED_API viewshed_status viewshed_set_threads(size_t count);

VIEWSHED_API viewshed_options viewshed_defaults(void);
VIEWSHED_API viewshed_sweep viewshed_no_sweep(void);

VIEWSHED_API viewshed_status viewshed_open(const viewshed_options *options, viewshed_stream *stream);

/* Write the state of each cell (cells * cells) and, unless null, the probability that a target there would be seen, and the
 * basis. */
VIEWSHED_API viewshed_status viewshed_estimate(viewshed_stream stream, const viewshed_sweep *sweep, uint8_t *state,
                                               float *visible_prob, size_t cells, viewshed_basis *basis);

/* Write the outline of the visible area (probability of at least one half) of the last successful estimate, as rings of
 * corners x, y in meters; the last corner joins the first. Ring k has the corners [begin[k], begin[k + 1]). Rings of one region
 * have the same number in region, negative for a hole. Arrays that are too short give VIEWSHED_ERROR_ROOM and the required
 * counts; begin has one element more than there are rings. */
VIEWSHED_API viewshed_status viewshed_outline(viewshed_stream stream, double *corners_m, size_t corner_room, int64_t *begin,
                                              int32_t *region, size_t ring_room, size_t *corner_count, size_t *ring_count);

VIEWSHED_API viewshed_status viewshed_close(viewshed_stream stream);

#ifdef __cplusplus
}
#endif

#endif
