/* The model as the runtime sees it: constant tables and two functions, generated from the plant's equations.
 *
 * The value reference of a variable is its position in `model.variables`, whose blocks follow one another:
 * time, states, derivatives of the states, inputs, algebraic outputs, parameters. */
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
    VARIABLE_TUNABLE_PARAMETER
} VariableKind;

typedef struct {
    const char *name;
    VariableKind kind;
    double start;
    double min;
    double max;
    double nominal;
} Variable;

typedef void (*ModelFunction)(double time, const double x[], const double u[], const double p[], double result[]);

typedef struct {
    const char *identifier;
    const char *guid;
    size_t n_variables;
    size_t n_states;
    size_t n_inputs;
    size_t n_outputs;
    const Variable *variables;
    double relative_tolerance;
    double absolute_tolerance; /* in units of the nominal value of each state */
    ModelFunction derivatives;
    ModelFunction outputs;
} Model;

extern const Model model;

#endif
