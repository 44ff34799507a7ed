/* wrenchbook.h: answers from a packed table (a .wbt file). MIT license, as all of wrenchbook.
 *
 * Units are SI: N, N·m, m, rad. A table has n inputs (loads: force then moment) and m outputs
 * (translation then rotation), 6 and 6 for one interface. The wrench acts ON the deformable
 * component at its interface point where it is now (it moves with the section), in axes fixed to the
 * undeformed interface frame. A moment M' about the undeformed point is M = M' - u x F here, with the
 * translation u that the table answers; a sensor at the point s has the lever s - (p0 + u), in these
 * axes. wb_json has the contract in words. A table is never written to: any number of threads may
 * answer from one, each with a scratch of its own. No answer allocates memory; wb_answer_many
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

/* What a call returns. */
enum {
    WB_OK = 0,
    WB_NOT_FINITE = 1,   /* an input or an output asked for is not a finite number */
    WB_NO_METHOD = 2,    /* the table does not have this method */
    WB_NO_MEMORY = 3,
    WB_NOT_SQUARE = 4,   /* wb_inverse: a load an output is needed */
    WB_SINGULAR = 5,     /* wb_inverse: du/dw has no inverse, or is not known */
    WB_NO_CONVERGENCE = 6, /* wb_inverse: `inputs` is the best wrench reached */
    WB_INDEFINITE = 7,     /* wb_joint_step: some motion of the part gives energy back */
    WB_NO_MASS = 8 /* wb_joint_step: the inverse mass is not symmetric and positive definite */
};

enum { WB_COVERED = 0, WB_THIN = 1, WB_OUTSIDE = 2 };

/* WB_ROW: a row of the table answers; WB_ESTIMATE: there are no rows to answer from. */
enum { /* the default method answers for WB_KRIGING where the rows allow no kriging */
    WB_DEFAULT = -1,
    WB_GRIDDATA = 0,
    WB_ADDITIVE = 1,
    WB_KRIGING = 2,
    WB_LINEAR = 3,
    WB_METHODS = 4,
    WB_ROW = 4,
    WB_ESTIMATE = 5
};

/* Why an answer is not covered. surrogate/kernel/reasons.py has the words. */
enum {
    WB_REASON_EMPTY = 1,            /* the table has no rows */
    WB_REASON_ONLY_BEYOND = 2,      /* all rows are outside the load range */
    WB_REASON_BEYOND_RANGE = 3,     /* index: input; value: the load; limit: the end passed */
    WB_REASON_UNKNOWN_LOAD = 4,     /* index: input whose influence no row shows */
    WB_REASON_AXIS_NO_ROWS = 5,     /* axis */
    WB_REASON_AXIS_OFF_HULL = 6,    /* axis */
    WB_REASON_MOMENT_ALONE = 10,    /* axis; index: input; value: the moment */
    WB_REASON_INTERACTION = 12,     /* no row loads several axes together as much */
    WB_REASON_BEYOND_SPAN = 13,     /* index: input; value: the load; rows do not span it */
    WB_REASON_OVER_TOLERANCE = 14,  /* index: output; value: interpolation error; limit */
    WB_REASON_NO_ERROR = 15,        /* no row shows how far off this answer may be */
    WB_REASON_ERRORS_UNKNOWN = 16,  /* rows left out do not show how large errors are */
    WB_REASON_BEYOND_LIMITS = 17,   /* an estimate beyond the table's limits is not given */
    WB_REASON_TOO_FAR = 19,         /* value: sigma; limit: largest sigma with known errors */
    WB_REASON_NOT_IN_SCENE = 20,    /* index: input; value: the load; limit: the end passed */
    WB_REASON_FEW_ROWS = 22         /* too few for kriging, and for the compliance */
};

typedef struct wb_table wb_table;

typedef struct {
    int method;              /* WB_DEFAULT, or the method to answer by */
    const double *tolerance; /* of each output, NaN for the component's own; NULL: all its own */
    int without_rows; /* not 0: the method alone answers, no row of the table at its own wrench */
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
    int32_t method;   /* what answered */
    int32_t exact;    /* whether `row` has just this wrench */
    int32_t reasons;  /* entries of `reason` */
    int32_t group;    /* the group of outputs that decided coverage */
    int32_t unknown;  /* how many of outputs and errors below are NaN */
    int32_t unused;
    int64_t row;      /* number (seq) of the row that answered, or -1 */
    int64_t index;    /* its index among the group's rows, or -1 */
    uint64_t missing; /* bit q: no row of the table holds output q */
    double inputs[WB_MAX]; /* as they were used: locked inputs are zero */
    double outputs[WB_MAX];
    double error[WB_MAX];
    double interpolation[WB_MAX], discretisation[WB_MAX], linearity[WB_MAX];
    double measurement[WB_MAX]; /* hysteresis and drift of the measured rows */
    wb_reason reason[WB_MAX_REASONS];
    uint64_t solved; /* bit q: output q is that of a row or an exact fit, not an interpolated one */
} wb_reply;

/* What one of the three axes contributes (default space only). */
typedef struct {
    int32_t coverage, origin; /* origin: the axis whose rows answered, -1 without rows */
    int32_t corners, corner[4]; /* points of that axis' triangulation */
    int32_t reasons;
    double outputs[6];
    wb_reason reason;
} wb_axis_reply;

/* Map a table; NULL and a reason of at most `size` bytes in `why`. */
WB_API wb_table *wb_open(const char *path, char *why, size_t size);
/* The same of a file's bytes, aligned to 8 bytes; they must outlive the table. */
WB_API wb_table *wb_open_bytes(const void *bytes, size_t count, char *why, size_t size);
/* The same of aligned bytes of at least 64 bytes whose header and checksum the caller has checked. */
WB_API wb_table *wb_open_checked(const void *bytes, size_t count, char *why, size_t size);
WB_API void wb_close(wb_table *table);

WB_API int wb_inputs(const wb_table *table);
WB_API int wb_outputs(const wb_table *table);
WB_API const char *wb_json(const wb_table *table); /* contract, space, methods, provenance */
WB_API size_t wb_scratch(const wb_table *table);   /* bytes of scratch, aligned to 8 bytes */

/* Answer one wrench. A NULL `options` is the component's own method and tolerance. */
WB_API int wb_answer(const wb_table *table, const wb_options *options, const double *inputs,
                     wb_reply *reply, void *scratch);
/* Answer n wrenches, row by row: outputs and total errors (n, m), coverage (n), with `threads`
 * threads. The numbers are those of wb_answer to the last bit. */
WB_API int wb_answer_many(const wb_table *table, const wb_options *options, size_t n,
                          const double *inputs, double *outputs, double *errors,
                          unsigned char *coverage, int threads);
/* du/dw (m, n) of the answer; NaN where it is not known. */
WB_API int wb_derivative(const wb_table *table, const wb_options *options, const double *inputs,
                         double *du_dw, void *scratch);
WB_API int wb_derivative_many(const wb_table *table, const wb_options *options, size_t n,
                              const double *inputs, double *du_dw, int threads);
/* Find the wrench whose displacement is `outputs` by Newton's method from `inputs`, by the
 * method's interpolant alone. Further inputs stay as they are. `stiffness`: the inverse of du/dw
 * there, (n, m); before the call that of a displacement nearby, which saves slopes, or zeros. Rows
 * and columns of locked inputs are zero, and rows of further inputs. */
WB_API int wb_inverse(const wb_table *table, const wb_options *options, const double *outputs,
                      double *inputs, double *stiffness, void *scratch);
/* The change of a joint's wrench with the relative velocity, C (n, n), n at most 24:
 * C = sum over the modes of stiffness (n, n) against inverse mass (n, n) of dt theta omega^2 +
 * 2 damping omega, theta = clip(1 - 0.5 / (omega dt)^2, 0, 1). The step is
 * (I + dt C A) w' = w + C v, v the velocity that the bodies would have without the joint.
 * WB_SINGULAR if the inverse mass is not symmetric and positive definite. */
WB_API int wb_joint_rate(int n, const double *stiffness, const double *inverse_mass, double dt,
                         double damping, double *rate);
/* A joint: the part between a rigid body, its base, and one at each of the k interfaces that move,
 * its tips, as a force element. Numbers of an interface are in the axes of its undeformed frame,
 * which moves with the base. Interfaces of which all loads are locked have no tip. */
typedef struct {
    wb_options answer;    /* as of wb_inverse */
    const double *inputs; /* (n): the further inputs as they are; loads in it count for nothing */
    const double *axes;   /* (k, 3, 3): interface frame's axes, its columns, in a tip whose quaternion,
                           * spin and moment have the tip's own axes; NULL: the frame's */
    double dt, damping;   /* s; share of critical of each mode of the part between the bodies */
    int errors;           /* not 0: coverage and errors too, which takes one more answer */
    int law;              /* not 0: force and C alone, by the velocities before the step, of freedoms
                           * of which the simulator has those after it; NaN: not known. Modes of an
                           * undamped part up to omega dt = pi keep their energy if they are known */
} wb_joint;

/* One step of a joint of one interface. NaN where unknown. That of k interfaces has the same members
 * in the same order and n = 6 k freedoms: (k, 6) for each (6), (n, n) for each (6, 6), (k, 3, 3)
 * spins and (k) coverages, and ends at a multiple of 8 bytes. */
typedef struct {
    double wrench[6];       /* on the part, about the interface point where it is now */
    double displacement[6]; /* m; rotation vector, rad */
    double still[6];        /* the wrench of the pose alone */
    double force[6];        /* the same, its moment in the axes of the spin; of a law less what C v
                             * has of the velocities before the step */
    double rate[36];        /* C, its change with the velocity, (6, 6) */
    double stiffness[36];   /* (6, 6), symmetric: by translation and angle about the frame's axes */
    double spin[9];         /* (3, 3): from the axes of the spin to the frame's */
    double frequency[6];    /* rad/s, of the modes of the freedoms that move; 0 for others */
    double pose_error[6];   /* of the displacement under this wrench */
    double wrench_error[6]; /* of the wrench of this pose: sum of |stiffness| times pose_error */
    double ranges;          /* how far out the pose is, in load ranges or 20 degrees; 1 is the end */
    int32_t coverage;       /* of the wrenches at the pose, or -1: not asked for */
    int32_t status;         /* WB_OK; WB_NOT_FINITE, WB_SINGULAR (no wrench belongs to the pose),
                             * WB_NO_MASS, or WB_INDEFINITE, which has all the same numbers */
} wb_joint_reply;

/* The number of a table's interfaces that move, k: a joint has 1 to 4. */
WB_API int wb_joint_interfaces(const wb_table *table);
/* The doubles of memory that a joint keeps from step to step; zeros to begin with. */
WB_API size_t wb_joint_memory(const wb_table *table);
WB_API size_t wb_joint_reply_size(const wb_table *table); /* bytes */
/* One step of each of n joints: poses (n, k, 7), translation, m, and quaternion, w first, of the tips'
 * interface frames; velocities (n, k, 6), m/s and rad/s, which the interfaces would have after the
 * step if the part did not pull; inverse_masses (n, 6 k, 6 k), accelerations by unit loads on the tips
 * and their reactions on the base, 1/kg to 1/(kg·m^2). The wrench w' is the solution of
 * (I + dt C A) w' = w + C v. Without velocities it is that of the pose, without masses C is NaN.
 * `scratch`: of one thread, or NULL. Returns WB_OK whatever the status of a joint is, and
 * WB_NOT_SQUARE for a table that no joint takes. */
WB_API int wb_joint_step(const wb_table *table, const wb_joint *joint, size_t n, const double *poses,
                         const double *velocities, const double *inverse_masses, double *memory,
                         void *replies, int threads, void *scratch);
/* What axis 0, 1 or 2 contributes to the answer of one group of outputs. */
WB_API int wb_axis(const wb_table *table, int group, int axis, const double *inputs,
                   wb_axis_reply *reply);
/* The hash of the sources that this library was compiled from. */
WB_API const char *wb_sources(void);

#ifdef __cplusplus
}
#endif
#endif
