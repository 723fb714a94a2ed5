/* The model as the runtime sees it: constant tables and three functions, generated from the plant's equations.
 *
 * The value reference of a variable is its position in `model.variables`, whose blocks follow one another:
 * time, states, derivatives of the states, inputs, algebraic outputs, parameters. Of a sampled block: time, samples,
 * held outputs (see sampled_block.h). */
#ifndef MODEL_H
#define MODEL_H

#include <stddef.h>

typedef enum {
    VARIABLE_TIME,
    VARIABLE_STATE,
    VARIABLE_DERIVATIVE,
    VARIABLE_INPUT,
    VARIABLE_OUTPUT,
    VARIABLE_FIXED_PARAMETER,
    VARIABLE_TUNABLE_PARAMETER,
    VARIABLE_SAMPLE, /* an input of a sampled block; NaN: it was not measured */
    VARIABLE_HELD    /* an output of a sampled block */
} VariableKind;

typedef struct {
    const char *name;
    VariableKind kind;
    double start;
    double min;
    double max;
    double nominal;
} Variable;

/* An element of the Jacobian that is not zero everywhere, by value references. */
typedef struct {
    unsigned unknown; /* a derivative or an algebraic output */
    unsigned known;   /* what it is differentiated by: time, a state, an input or a parameter */
} Partial;

typedef void (*ModelFunction)(double time, const double x[], const double u[], const double p[], double result[]);

typedef struct {
    const char *identifier;
    const char *guid;
    size_t n_variables;
    size_t n_states;
    size_t n_inputs;
    size_t n_outputs;
    size_t n_partials;
    const Variable *variables;
    const Partial *partials;
    double relative_tolerance;
    double absolute_tolerance; /* in units of the nominal value of each state */
    ModelFunction derivatives; /* NULL: there is nothing to integrate, a sampled block */
    ModelFunction outputs;
    ModelFunction jacobian; /* its elements in the order of `partials` */
} Model;

extern const Model model;

#endif
