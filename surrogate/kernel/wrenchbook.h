/* wrenchbook.h: answers from a packed table (a .wbt file). MIT license, as all of wrenchbook.
 *
 * Units are SI: N, N·m, m, rad. A table has n inputs (loads: force then moment) and m outputs
 * (translation then rotation), 6 and 6 for one interface. The wrench acts ON the deformable
 * component at its interface point where it is now (it moves with the section), in axes fixed to the
 * undeformed interface frame. A moment M' about the undeformed point is M = M' - u x F here, with the
 * translation u that the table answers; a sensor at the point s has the lever s - (p0 + u), in these
 * axes. wb_json returns the contract as text. A table is read-only: any number of threads may
 * answer from it, each with a scratch of its own. An answer allocates no memory; wb_answer_many
 * allocates once a call.
 */
#ifndef WRENCHBOOK_H
#define WRENCHBOOK_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(WB_SHARED) && defined(_WIN32)
#define WB_API __declspec(dllexport)
#elif defined(WB_SHARED)
#define WB_API __attribute__((visibility("default")))
#else
#define WB_API
#endif

enum { WB_MAX = 64, WB_MAX_REASONS = 32 }; /* inputs, outputs; reasons of one answer */

/* Return values. */
enum {
    WB_OK = 0,
    WB_NOT_FINITE = 1,   /* an input, or an output of wb_inverse, is not a finite number */
    WB_NO_METHOD = 2,    /* the table does not have this method */
    WB_NO_MEMORY = 3,
    WB_NOT_SQUARE = 4,   /* wb_inverse: the table needs one output for each load */
    WB_SINGULAR = 5,     /* wb_inverse: du/dw has no inverse, or is not known */
    WB_NO_CONVERGENCE = 6, /* wb_inverse: `inputs` is the best wrench reached */
    WB_INDEFINITE = 7,     /* wb_joint_step: the stiffness is not positive definite */
    WB_NO_MASS = 8 /* wb_joint_step: the inverse mass is not symmetric and positive definite */
};

enum { WB_COVERED = 0, WB_THIN = 1, WB_OUTSIDE = 2 };

/* Methods. WB_ROW: a row of the table answers; WB_ESTIMATE: the table has no rows. Where the rows
 * allow no kriging, the default method answers for WB_KRIGING. */
enum {
    WB_DEFAULT = -1,
    WB_GRIDDATA = 0,
    WB_ADDITIVE = 1,
    WB_KRIGING = 2,
    WB_LINEAR = 3,
    WB_METHODS = 4,
    WB_ROW = 4,
    WB_ESTIMATE = 5
};

/* Reasons for which an answer is not covered; surrogate/kernel/reasons.py has their texts. */
enum {
    WB_REASON_EMPTY = 1,            /* the table has no rows */
    WB_REASON_ONLY_BEYOND = 2,      /* all rows are outside the load range */
    WB_REASON_BEYOND_RANGE = 3,     /* index: input; value: the load; limit: the end passed */
    WB_REASON_UNKNOWN_LOAD = 4,     /* index: input whose influence no row shows */
    WB_REASON_AXIS_NO_ROWS = 5,     /* axis */
    WB_REASON_AXIS_OFF_HULL = 6,    /* axis */
    WB_REASON_MOMENT_ALONE = 10,    /* axis; index: input; value: the moment */
    WB_REASON_INTERACTION = 12,     /* no row loads several axes together as much */
    WB_REASON_BEYOND_SPAN = 13,     /* index: input; value: the load, beyond those of the rows */
    WB_REASON_OVER_TOLERANCE = 14,  /* index: output; value: interpolation error; limit */
    WB_REASON_NO_ERROR = 15,        /* no row shows the error of this answer */
    WB_REASON_ERRORS_UNKNOWN = 16,  /* left-out rows do not show the size of errors */
    WB_REASON_BEYOND_LIMITS = 17,   /* the estimate exceeds the table's limits and is NaN */
    WB_REASON_TOO_FAR = 19,         /* value: sigma; limit: largest sigma with known errors */
    WB_REASON_NOT_IN_SCENE = 20,    /* index: input; value: the load; limit: the end passed */
    WB_REASON_FEW_ROWS = 22         /* too few rows for kriging, and for the compliance */
};

typedef struct wb_table wb_table;

typedef struct {
    int method;              /* WB_DEFAULT, or a method; 0 is WB_GRIDDATA, so set it */
    const double *tolerance; /* (m), NaN for the component's tolerance; NULL: all the component's */
    int without_rows;        /* not 0: the method answers, also at the wrench of a row */
} wb_options;

typedef struct {
    int32_t code, group, axis, index;
    double value, limit;
} wb_reason;

/* NaN where unknown. The total error is the sum of the four parts; where the discretisation error
 * is not known it is the interpolation error alone, and NaN for outputs in `solved`. */
typedef struct {
    int32_t coverage; /* WB_COVERED, WB_THIN or WB_OUTSIDE */
    int32_t within;   /* 1: the total error is within the tolerance, 0: it is not, -1: not known */
    int32_t method;   /* the method that answered */
    int32_t exact;    /* not 0: `row` has exactly this wrench */
    int32_t reasons;  /* number of entries of `reason` */
    int32_t group;    /* the group of outputs that decided coverage */
    int32_t unknown;  /* number of outputs and errors below that are NaN */
    int32_t unused;
    int64_t row;      /* number (seq) of the row that answered, or -1 */
    int64_t index;    /* its index among the group's rows, or -1 */
    uint64_t missing; /* bit q: no row of the table has output q */
    double inputs[WB_MAX]; /* the inputs in use: locked inputs are zero */
    double outputs[WB_MAX];
    double error[WB_MAX];
    double interpolation[WB_MAX], discretisation[WB_MAX], linearity[WB_MAX];
    double measurement[WB_MAX]; /* hysteresis and drift of the measured rows */
    wb_reason reason[WB_MAX_REASONS];
    uint64_t solved; /* bit q: output q is that of a row or an exact fit, not interpolated */
} wb_reply;

/* The contribution of one of the three axes (default space only). */
typedef struct {
    int32_t coverage, origin; /* origin: the axis whose rows answered, -1 without rows */
    int32_t corners, corner[4]; /* points of that axis' triangulation */
    int32_t reasons;
    double outputs[6];
    wb_reason reason;
} wb_axis_reply;

/* Map a table. On failure returns NULL and writes a reason of at most `size` bytes into `why`. The file
 * must not change while it is mapped: replace it by a rename, do not write into it. */
WB_API wb_table *wb_open(const char *path, char *why, size_t size);
/* The same from the bytes of a file, aligned to 8 bytes; they must outlive the table. */
WB_API wb_table *wb_open_bytes(const void *bytes, size_t count, char *why, size_t size);
/* The same from at least 64 aligned bytes, of which the caller has checked header and checksum. */
WB_API wb_table *wb_open_checked(const void *bytes, size_t count, char *why, size_t size);
WB_API void wb_close(wb_table *table);

WB_API int wb_inputs(const wb_table *table);
WB_API int wb_outputs(const wb_table *table);
WB_API const char *wb_json(const wb_table *table); /* contract, space, methods, provenance */
WB_API size_t wb_scratch(const wb_table *table);   /* bytes of scratch, aligned to 8 bytes */

/* Answer one wrench. NULL `options`: the component's method and tolerance. */
WB_API int wb_answer(const wb_table *table, const wb_options *options, const double *inputs,
                     wb_reply *reply, void *scratch);
/* Answer n wrenches (n, inputs) with `threads` threads: outputs and total errors (n, m), coverage
 * (n). The numbers are those of wb_answer to the last bit. */
WB_API int wb_answer_many(const wb_table *table, const wb_options *options, size_t n,
                          const double *inputs, double *outputs, double *errors,
                          unsigned char *coverage, int threads);
/* du/dw (m, n) of the answer; NaN where unknown. */
WB_API int wb_derivative(const wb_table *table, const wb_options *options, const double *inputs,
                         double *du_dw, void *scratch);
WB_API int wb_derivative_many(const wb_table *table, const wb_options *options, size_t n,
                              const double *inputs, double *du_dw, int threads);
/* The wrench whose displacement is `outputs`, by Newton's method from `inputs` on the method's
 * interpolant. Further inputs do not change. `stiffness` (n, m): on return the inverse of du/dw
 * there; on entry that of a nearby displacement, which saves slopes, or zeros. Rows and columns of
 * locked inputs, and rows of further inputs, are zero. */
WB_API int wb_inverse(const wb_table *table, const wb_options *options, const double *outputs,
                      double *inputs, double *stiffness, void *scratch);
/* The change of a joint's wrench with the relative velocity, C (n, n), n at most 24:
 * C = sum over the modes of stiffness (n, n) against inverse mass (n, n) of dt theta omega^2 +
 * 2 damping omega, theta = clip(1 - 0.5 / (omega dt)^2, 0, 1). The step is
 * (I + dt C A) w' = w + C v, A the inverse mass, v the velocity of the bodies without the joint.
 * WB_SINGULAR if the inverse mass is not symmetric and positive definite. */
WB_API int wb_joint_rate(int n, const double *stiffness, const double *inverse_mass, double dt,
                         double damping, double *rate);
/* A joint: the part as a force element between a rigid body, its base, and a body at each of the k
 * interfaces that move, its tips. Numbers of an interface are in the axes of its undeformed frame,
 * which moves with the base. Interfaces with all loads locked have no tip. */
typedef struct {
    wb_options answer;    /* as of wb_inverse */
    const double *inputs; /* (n): the further inputs; its loads are ignored */
    const double *axes;   /* (k, 3, 3): interface frame's axes, its columns, in a tip whose quaternion,
                           * spin and moment have the tip's own axes; NULL: the frame's */
    double dt, damping;   /* s; damping ratio of each mode of the part between the bodies */
    int errors;           /* not 0: also coverage and errors, by one more answer */
    int law;              /* not 0: force and C alone, by the velocities before the step, of freedoms
                            * whose velocities after it the simulator has; NaN: unknown. Modes of an
                            * undamped part up to omega dt = pi keep their energy if they are known */
} wb_joint;

/* One step of a joint of one interface. NaN where unknown. That of k interfaces has the same members
 * in the same order and n = 6 k freedoms: (k, 6) for each (6), (n, n) for each (6, 6), (k, 3, 3)
 * spins and (k) coverages, and ends at a multiple of 8 bytes. */
typedef struct {
    double wrench[6];       /* on the part, about the interface point where it is now */
    double displacement[6]; /* m; rotation vector, rad */
    double still[6];        /* the wrench of the pose, without the rate */
    double force[6];        /* the same, its moment in the axes of the spin; of a law less the part of
                             * C v of the velocities before the step */
    double rate[36];        /* C, its change with the velocity, (6, 6) */
    double stiffness[36];   /* (6, 6), symmetric: by translation and angle about the frame's axes */
    double spin[9];         /* (3, 3): from the axes of the spin to the frame's */
    double frequency[6];    /* rad/s, of the modes of the freedoms that move; 0 for others */
    double pose_error[6];   /* of the displacement under this wrench */
    double wrench_error[6]; /* of the wrench of this pose: sum of |stiffness| times pose_error */
    double ranges;          /* the pose in multiples of the load range or of 20 degrees; 1: the end */
    int32_t coverage;       /* of the wrenches at the pose, or -1: not computed */
    int32_t status;         /* WB_OK; WB_NOT_FINITE (also dt not above 0, damping below 0), WB_SINGULAR
                             * (the pose has no wrench), WB_NO_MASS; WB_INDEFINITE, with all numbers */
} wb_joint_reply;

/* The number of a table's interfaces that move, k: a joint has 1 to 4. */
WB_API int wb_joint_interfaces(const wb_table *table);
/* The number of doubles of memory that a joint keeps between steps; initially zeros. */
WB_API size_t wb_joint_memory(const wb_table *table);
WB_API size_t wb_joint_reply_size(const wb_table *table); /* bytes */
/* One step of each of n joints: poses (n, k, 7), translation, m, and quaternion, w first, of the tips'
 * interface frames; velocities (n, k, 6), m/s and rad/s, of the interfaces after the
 * step without the part; inverse_masses (n, 6 k, 6 k), accelerations by unit loads on the tips
 * and their reactions on the base, 1/kg to 1/(kg·m^2). The wrench w' is the solution of
 * (I + dt C A) w' = w + C v. NULL velocities: the wrench of the pose; NULL masses: C is NaN.
 * `scratch`: of one thread, or NULL. Returns WB_OK for any status of a joint, and
 * WB_NOT_SQUARE for a table that cannot be a joint. */
WB_API int wb_joint_step(const wb_table *table, const wb_joint *joint, size_t n, const double *poses,
                         const double *velocities, const double *inverse_masses, double *memory,
                         void *replies, int threads, void *scratch);
/* The contribution of axis 0, 1 or 2 to the answer of one group of outputs. */
WB_API int wb_axis(const wb_table *table, int group, int axis, const double *inputs,
                   wb_axis_reply *reply);
/* The hash of the sources that this library was compiled from. */
WB_API const char *wb_sources(void);

#ifdef __cplusplus
}
#endif
#endif
