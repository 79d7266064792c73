from services.cloud_merger.app import main

raise SystemExit(main())
