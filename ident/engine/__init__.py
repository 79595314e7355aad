"""The only place that knows CasADi's symbols and machine code: graphs, the kernels made of them, the compiler."""
