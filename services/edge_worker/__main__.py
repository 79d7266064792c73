from services.edge_worker.app import main

raise SystemExit(main())
