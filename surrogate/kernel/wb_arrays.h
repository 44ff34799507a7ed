/* The arrays of a packed table. Made by `python -m wrenchbook.surrogate.packed.arrays`;
 * surrogate/packed/arrays.py says what each is. MIT license. */
#ifndef WB_ARRAYS_H
#define WB_ARRAYS_H
#include "wb_internal.h"
/* Sizes: of the table, shared by the factors of a kriging, of one block. */
enum { WB_OF_N, WB_OF_M, WB_OF_N1, WB_OF_S, WB_OF_R, WB_OF_T, WB_OF_B, WB_OF_V, WB_OF_K, WB_OF_E,
WB_OF_D, WB_OF_C, WB_OF_W, WB_OF_I, WB_OF_P, WB_OF_P1, WB_OF_F, WB_OF_G, WB_OF_U, WB_SIZES,
    WB_BLOCK = WB_OF_S, WB_FACTOR = WB_OF_R };
typedef struct { /* each dimension is a size or, below zero, a number */
    const char *name;
    int type, optional, dimensions, shape[3];
    size_t member;
} wb_array;
static const wb_array WB_SPACE_ARRAYS[] = {
    {"sizes", WB_I4, 0, 1, {-3}, offsetof(wb_table, sizes)},
    {"ends", WB_F8, 0, 2, {-2, WB_OF_N}, offsetof(wb_table, ends)},
    {"scale", WB_F8, 0, 1, {WB_OF_N}, offsetof(wb_table, scale)},
    {"small", WB_F8, 0, 1, {WB_OF_N}, offsetof(wb_table, small)},
    {"locked", WB_I4, 0, 1, {WB_OF_N}, offsetof(wb_table, locked)},
    {"tolerance", WB_F8, 0, 1, {WB_OF_M}, offsetof(wb_table, tolerance)},
    {"rig_error", WB_F8, 1, 1, {WB_OF_M}, offsetof(wb_table, rig_error)},
    {"limit", WB_F8, 0, 1, {WB_OF_M}, offsetof(wb_table, limit)},
    {"vector_first", WB_I4, 0, 1, {WB_OF_V}, offsetof(wb_table, vector_first)},
    {"vector_limit", WB_F8, 0, 1, {WB_OF_V}, offsetof(wb_table, vector_limit)},};
static const wb_array WB_SOLVER_ARRAYS[] = {
    {"flags", WB_I4, 0, 1, {-5}, offsetof(wb_solver, flags)},
    {"mesh", WB_F8, 0, 2, {WB_OF_M, WB_OF_N}, offsetof(wb_solver, mesh)},
    {"stiffness", WB_F8, 0, 2, {WB_OF_N, WB_OF_M}, offsetof(wb_solver, stiffness)},
    {"linearity", WB_F8, 0, 1, {WB_OF_M}, offsetof(wb_solver, linearity)},
    {"saturation", WB_F8, 1, 1, {WB_OF_M}, offsetof(wb_solver, saturation)},
    {"one_over", WB_F8, 0, 1, {WB_OF_N}, offsetof(wb_solver, one_over)},
    {"second", WB_F8, 1, 3, {WB_OF_M, WB_OF_N, WB_OF_N}, offsetof(wb_solver, second)},
    {"zero", WB_F8, 1, 1, {WB_OF_N}, offsetof(wb_solver, zero)},};
static const wb_array WB_SCENE_ARRAYS[] = {
    {"ends", WB_F8, 0, 2, {-2, WB_OF_N}, offsetof(wb_table, scene_ends)},
    {"varying", WB_I4, 0, 1, {WB_OF_N}, offsetof(wb_table, scene_varying)},
    {"slopes", WB_I4, 0, 1, {WB_OF_N}, offsetof(wb_table, scene_slopes)},};
static const wb_array WB_GROUP_ARRAYS[] = {
    {"flags", WB_I4, 0, 1, {-4}, offsetof(wb_group, flags)},
    {"outputs", WB_I4, 0, 1, {WB_OF_M}, offsetof(wb_group, outputs)},
    {"held", WB_I4, 1, 1, {WB_OF_M}, offsetof(wb_group, held)},
    {"allowed", WB_F8, 0, 1, {WB_OF_M}, offsetof(wb_group, allowed)},};
static const wb_array WB_FIT_ARRAYS[] = {
    {"matrix", WB_F8, 0, 2, {WB_OF_M, WB_OF_N}, offsetof(wb_fit, matrix)},
    {"bar", WB_F8, 0, 1, {WB_OF_M}, offsetof(wb_fit, bar)},
    {"offset", WB_F8, 1, 1, {WB_OF_M}, offsetof(wb_fit, offset)},
    {"known", WB_I4, 0, 1, {WB_OF_N}, offsetof(wb_fit, known)},};
static const wb_array WB_ROW_ARRAYS[] = {
    {"key", WB_F8, 0, 1, {WB_OF_R}, offsetof(wb_rows, key)},
    {"bucket", WB_F8, 0, 1, {-2}, offsetof(wb_rows, bucket)},
    {"start", WB_I4, 0, 1, {WB_OF_B}, offsetof(wb_rows, start)},
    {"rates", WB_F8, 0, 1, {WB_OF_N}, offsetof(wb_rows, rates)},
    {"steepest", WB_F8, 0, 1, {WB_OF_M}, offsetof(wb_rows, steepest)},
    {"number", WB_I4, 0, 1, {WB_OF_R}, offsetof(wb_rows, number)},
    {"seq", WB_I8, 0, 1, {WB_OF_R}, offsetof(wb_rows, seq)},
    {"wrench", WB_F8, 0, 2, {WB_OF_R, WB_OF_N}, offsetof(wb_rows, wrench)},
    {"moved", WB_F8, 0, 2, {WB_OF_R, WB_OF_M}, offsetof(wb_rows, moved)},
    {"bar", WB_F8, 0, 2, {WB_OF_R, WB_OF_M}, offsetof(wb_rows, bar)},
    {"tangent_of", WB_I4, 0, 1, {WB_OF_R}, offsetof(wb_rows, tangent_of)},
    {"tangent", WB_F8, 0, 3, {WB_OF_T, WB_OF_M, WB_OF_N}, offsetof(wb_rows, tangent)},};
static const wb_array WB_AXES_ARRAYS[] = {
    {"simplex", WB_F8, 0, 2, {WB_OF_I, -16}, offsetof(wb_composition, simplex)},
    {"degenerate", WB_U1, 0, 1, {WB_OF_I}, offsetof(wb_composition, degenerate)},
    {"vertex", WB_F8, 0, 2, {WB_OF_P, -9}, offsetof(wb_composition, vertex)},
    {"slopes", WB_F8, 0, 3, {WB_OF_P, -6, -3}, offsetof(wb_composition, slopes)},
    {"facets", WB_I4, 0, 2, {WB_OF_F, -4}, offsetof(wb_composition, facets)},
    {"point_first", WB_I4, 0, 1, {-4}, offsetof(wb_composition, point_first)},
    {"simplex_first", WB_I4, 0, 1, {-4}, offsetof(wb_composition, simplex_first)},
    {"facet_first", WB_I4, 0, 1, {-4}, offsetof(wb_composition, facet_first)},
    {"floats", WB_F8, 0, 2, {-3, -22}, offsetof(wb_composition, floats)},
    {"ints", WB_I4, 0, 2, {-3, -5}, offsetof(wb_composition, ints)},
    {"grid", WB_I4, 0, 1, {WB_OF_G}, offsetof(wb_composition, grid)},
    {"zero_load", WB_F8, 0, 1, {-6}, offsetof(wb_composition, zero_load)},};
static const wb_array WB_CUT_ARRAYS[] = {
    {"state", WB_I4, 0, 1, {WB_OF_K}, offsetof(wb_cut, state)},
    {"stations", WB_F8, 0, 1, {WB_OF_U}, offsetof(wb_cut, stations)},
    {"outputs", WB_F8, 0, 3, {WB_OF_K, -2, -6}, offsetof(wb_cut, outputs)},
    {"bucket", WB_F8, 0, 1, {-2}, offsetof(wb_cut, bucket)},
    {"start", WB_I4, 0, 1, {WB_OF_B}, offsetof(wb_cut, start)},};
static const wb_array WB_KRIGING_ARRAYS[] = {
    {"x", WB_F8, 0, 2, {WB_OF_N, WB_OF_S}, offsetof(wb_kriging, x)},
    {"terms", WB_F8, 0, 2, {WB_OF_C, WB_OF_N1}, offsetof(wb_kriging, term)},
    {"weights", WB_F8, 0, 2, {WB_OF_M, WB_OF_W}, offsetof(wb_kriging, weights)},
    {"smoothness", WB_I4, 1, 1, {-1}, offsetof(wb_kriging, smoothness)},
    {"coefficients", WB_F8, 0, 2, {WB_OF_N1, WB_OF_M}, offsetof(wb_kriging, coefficients)},
    {"centre", WB_F8, 0, 1, {WB_OF_N}, offsetof(wb_kriging, centre)},
    {"rate", WB_F8, 0, 1, {WB_OF_N}, offsetof(wb_kriging, rate)},
    {"offset", WB_F8, 0, 1, {WB_OF_M}, offsetof(wb_kriging, offset)},
    {"spread", WB_F8, 0, 1, {WB_OF_M}, offsetof(wb_kriging, spread)},
    {"deviation", WB_F8, 0, 1, {WB_OF_M}, offsetof(wb_kriging, deviation)},
    {"lost", WB_F8, 0, 1, {WB_OF_M}, offsetof(wb_kriging, lost)},
    {"floor", WB_F8, 0, 1, {WB_OF_M}, offsetof(wb_kriging, floor)},
    {"tangent", WB_F8, 0, 2, {WB_OF_M, WB_OF_N}, offsetof(wb_kriging, tangent)},
    {"span", WB_F8, 0, 2, {-2, WB_OF_N}, offsetof(wb_kriging, span)},
    {"together", WB_F8, 0, 1, {-2}, offsetof(wb_kriging, together)},
    {"factor_count", WB_I4, 0, 1, {-1}, offsetof(wb_kriging, factor_count)},};
static const wb_array WB_FACTOR_ARRAYS[] = {
    {"outputs", WB_I4, 0, 1, {WB_OF_M}, offsetof(wb_factor, outputs)},
    {"number", WB_I4, 0, 1, {WB_OF_S}, offsetof(wb_factor, number)},
    {"equations", WB_I4, 0, 2, {WB_OF_K, WB_OF_E}, offsetof(wb_factor, equations)},
    {"panels", WB_F8, 0, 2, {WB_OF_K, WB_OF_D}, offsetof(wb_factor, panels)},
    {"trend", WB_F8, 0, 3, {WB_OF_K, WB_OF_N1, WB_OF_E}, offsetof(wb_factor, trend)},
    {"min_variance", WB_F8, 0, 1, {WB_OF_S}, offsetof(wb_factor, min_variance)},
    {"penalty", WB_F8, 0, 1, {WB_OF_S}, offsetof(wb_factor, penalty)},
    {"mean_covariance", WB_F8, 0, 2, {WB_OF_N1, WB_OF_N1}, offsetof(wb_factor, mean_covariance)},
    {"scale", WB_F8, 0, 1, {WB_OF_M}, offsetof(wb_factor, scale)},
    {"max_sigma", WB_F8, 0, 1, {-1}, offsetof(wb_factor, max_sigma)},};
#endif
